"""A recorded motion played on the emulated chain: player, controller, link, robot in one thread."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from helpers.control import hand_motions
from helpers.control.lagging_arm import asked, view_of
from helpers.hardware import emulated_chain, franka_chain
from helpers.hardware.emulated_chain import T
from surg_core.arm_view import ArmCommands, JawRange
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.playback.motion_file import read_motion
from surg_teleop.playback.motion_plan import make_plan
from surg_teleop.playback.motion_player import Mode, MotionPlayer, PlayerStage
from surg_teleop.playback.workspace_fit import Workspace

RATE = 30.0
"""[1/s] Of a recorded surgeon's motion."""


def surgeon(folder: Path, seed: int, seconds: float) -> Path:
    """A synthetic motion with a surgeon's speeds, as a file."""
    t = np.arange(round(RATE * seconds) + 1) / RATE
    p = hand_motions.strokes(seed, seconds)(t)
    roll = 0.4 * np.sin(0.9 * t + seed)
    file = folder / f"surgeon_{seed}.csv"
    rows = np.column_stack((t, p, roll))
    np.savetxt(file, rows, "%.9f", ",", header="t_s,x_m,y_m,z_m,roll_rad", comments="")
    return file


@dataclass(frozen=True)
class Played:
    """What came out.

    Attributes:
        stage: How the player ended.
        reason: Why it gave up; the operator's exit code is 1 then.
        deviation: Of the shaft from the trocar in every cycle of the stream [m], (n,).
        speed: Largest of the tip in it [m/s].
        state_hash: SHA-256 over the emulated arm's angles and the commands of all cycles.
    """

    stage: PlayerStage
    reason: str
    deviation: np.ndarray
    speed: float
    state_hash: str


def play(
    chain: emulated_chain.Chain | franka_chain.Chain,
    motion: Path,
    scale: float = 1.0,
    duration: float | None = None,
    each: Callable[[int], object] = lambda cycle: None,
) -> Played:
    """Play a motion on an arm that a person has started.

    Args:
        chain: With the controller DISABLED.
        motion: File of the motion.
        scale: Of the motion.
        duration: Of what is played [s]; None: the motion once.
        each: Called before every cycle with its number.
    """
    limits, instrument = chain.arm.limits, chain.arm.instrument
    workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
    plan = make_plan(read_motion(motion), workspace, scale, duration)
    jaw = JawRange(instrument.jaw_min, instrument.jaw_max)
    player = MotionPlayer(plan, Mode.CARTESIAN, jaw, StepLimits.of(limits))
    commands, away, tips, digest = ArmCommands(), [], [], hashlib.sha256()
    for cycle in range(200_000):
        each(cycle)
        out = chain.step(*asked(commands, chain.controller))
        digest.update(np.array(chain.joints).tobytes() + out.qd_command.tobytes())
        if player.stage is PlayerStage.PLAY:
            away.append(chain.deviation)
            tips.append(chain.tip)
        if player.done:
            break
        commands = player.tick(view_of(chain.arm, chain.controller, out, cycle + 1))
    steps = np.linalg.norm(np.diff(tips, axis=0), axis=1) if len(tips) > 1 else np.zeros(1)
    return Played(
        player.stage, player.reason, np.array(away), float(steps.max()) / T, digest.hexdigest()
    )
