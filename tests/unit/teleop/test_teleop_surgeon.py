"""A surgeon's hand at 30 Hz and scale 1 through the whole chain, controller and lag included.

The motion is a synthetic one with a surgeon's speeds, and the one that SURG_TEST_MOTION names
beside it. Full mode writes docs/results/teleoperation.md.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.control.lagging_arm import SOURCE, TICK, LaggingArm
from helpers.results.teleoperation_results import note
from helpers.teleop.hand import settings
from surg_cli.host import paths
from surg_core.arm_view import ArmCommands, ArmState, TipPose
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.follow.teleop_types import CameraView, TeleopState
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.leaders.bundled.motion import MotionLeader
from surg_teleop.playback.motion_file import read_motion
from surg_teleop.playback.motion_plan import CENTRE_DEPTH
from surg_teleop.playback.workspace_fit import Workspace, box_centre

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
GIVEN = os.environ.get("SURG_TEST_MOTION")
SECONDS = 120.0 if FULL else 5.0
RATE = 30.0
MAX_LAG, MAX_RMS = 0.015, 1e-3


@dataclass(frozen=True)
class Chain:
    """What one run measured.

    Attributes:
        lag: From the hand to the set-point [s], the shift that explains the most.
        rms: Of what is left of the set-point's error then [m].
        tip_lag: From the set-point to the tip [s].
        tip_rms: Of what is left then [m].
        let_go: What ended following; empty: nothing did.
        refused: ArmCommands that the arm refused.
    """

    lag: float
    rms: float
    tip_lag: float
    tip_rms: float
    let_go: str
    refused: int


def synthetic(folder: Path) -> Path:
    """A minute of a hand in a 50 mm box: rms 28 mm/s, peaks near 0.1 m/s, rolling and gripping."""
    t = np.arange(1800) / RATE
    rng = np.random.default_rng(19)
    p = np.zeros((len(t), 3))
    for axis in range(3):
        for _ in range(6):
            f, phase = rng.uniform(0.1, 0.8), rng.uniform(0.0, 2.0 * np.pi)
            p[:, axis] += 0.0045 / np.sqrt(f / 0.3) * np.sin(2.0 * np.pi * f * t + phase)
    roll = 0.6 * np.sin(2.0 * np.pi * 0.2 * t)
    grip = 0.3 + 0.3 * np.sin(2.0 * np.pi * 0.15 * t)
    path = folder / "synthetic.csv"
    header = "t_s,x_m,y_m,z_m,roll_rad,gripper_rad"
    np.savetxt(path, np.column_stack((t, p, roll, grip)), delimiter=",", header=header, comments="")
    return path


def run(file: Path, seconds: float) -> Chain:
    """Plays the file by hand into the UR5e; the view is turned against the rcm frame."""
    arm = surg_core.load_cell(paths.ROOT / "cells/sim_ur5e").arms["PSM1"]
    limits, plant = arm.limits, LaggingArm(arm)
    motion = read_motion(file)
    box = motion.cut(seconds).p
    start = np.array([0.0, 0.0, CENTRE_DEPTH]) + box[0] - box_centre(box)
    commands = ArmCommands()
    for state in ("home", "enable"):
        plant.step(commands)
        commands = ArmCommands(state=state)
    plant.step(commands)
    plant.step(ArmCommands(move_cp=TipPose(start, 0.0)))
    for _ in range(3000):
        plant.step(ArmCommands())
        if not plant.out.busy:
            break

    workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
    teleop = Teleop(settings(workspace=workspace, step=StepLimits.of(limits)), scale=1.0)
    teleop.enable()
    leader = MotionLeader(str(file), rate=RATE, delay=1.0)
    leader.open()
    began = (plant.tick + 1) * TICK
    commands, times, goals, tips, let_go = ArmCommands(), [], [], [], ""
    while plant.tick * TICK < began + 1.0 + min(seconds, motion.duration):
        plant.step(commands)
        now = plant.tick * TICK
        view = plant.view({SOURCE: "/teleop"})
        # The view looks along the trocar frame's axes, wherever that lies in the world.
        out = teleop.tick(now, leader.read(now), view, CameraView(view.R_WR))
        commands = out.commands
        if out.state is TeleopState.CLUTCHED and not let_go:
            let_go = out.message
        t = now - began - 1.0
        if t > 0.5:
            times.append(t)
            goals.append(view.p_set)
            tips.append(view.p_tip)
    assert view.state == ArmState.ENABLED
    spline = motion.spline()
    offset = start - motion.p[0]
    goal, tip, t = np.array(goals), np.array(tips), np.array(times)
    lags = np.arange(-0.01, 0.06, 0.0005)
    errors = [_rms(goal - offset - spline(np.maximum(t - lag, 0.0))[:, :3]) for lag in lags]
    best = int(np.argmin(errors))
    ticks = range(40)
    tip_errors = [_rms(tip[k:] - goal[: len(goal) - k]) for k in ticks]
    return Chain(
        lag=float(lags[best]),
        rms=float(errors[best]),
        tip_lag=int(np.argmin(tip_errors)) * TICK,
        tip_rms=float(min(tip_errors)),
        let_go=let_go,
        refused=view.refused,
    )


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


@pytest.mark.parametrize("which", ["synthetic", *(["recording"] if GIVEN else [])])
def test_a_surgeons_hand_is_followed(which: str, tmp_path: Path) -> None:
    file = synthetic(tmp_path) if which == "synthetic" else Path(str(GIVEN))
    chain = run(file, SECONDS)
    note(
        f"lag: {which}",
        1,
        f"hand to set-point {1e3 * chain.lag:.1f} ms, {1e3 * chain.rms:.2f} mm rms; set-point to "
        f"tip {1e3 * chain.tip_lag:.0f} ms, {1e3 * chain.tip_rms:.2f} mm rms",
    )
    assert chain.let_go == ""
    assert chain.refused == 0
    assert chain.lag <= MAX_LAG
    assert chain.rms <= MAX_RMS
