"""Every stop keeps the arm within its limits, and a state that cannot be is not used.

Judged by the motion of a plant with joints of its own (`joint_plant`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.control.fault_bench import shipped
from helpers.control.joint_plant import ROBOTS, JointPlant, T, pose, sideways
from surg_core import (
    Controller,
    ForceSample,
    Motion,
    MotionCommand,
    Readings,
    Reason,
    State,
    StateCommand,
)

SPEEDS = (0.02, 0.06, 0.1, 0.15)
"""Of the tip as the stop begins [m/s]."""
LAGS = {"sim_ur5e": np.linspace(0.006, 0.012, 6), "sim_panda": np.linspace(0.006, 0.012, 7)}


def nan(arm: JointPlant) -> dict[str, Any]:
    return {"q": np.full(len(arm.q), np.nan)}


def hard_force(arm: JointPlant) -> dict[str, Any]:
    return {"readings": Readings(tip_force=ForceSample([0.0, 0.0, 50.0]))}


WAYS: dict[str, tuple[Callable[[JointPlant], dict[str, Any]], Reason]] = {
    "not a number": (nan, Reason.STATE_NOT_FINITE),
    "stale": (lambda arm: {"state_age": 0.5}, Reason.LINK_LOST),
    "missing": (lambda arm: {"state_valid": False}, Reason.LINK_LOST),
    "a hard force": (hard_force, Reason.FORCE),
}


@pytest.mark.parametrize("cell", ROBOTS)
@pytest.mark.parametrize("way", WAYS)
def test_a_stop_without_a_state_keeps_the_acceleration(cell: str, way: str, full: bool) -> None:
    broken, reason = WAYS[way]
    worst = 0.0
    for speed in np.linspace(0.02, 0.15, 20) if full else SPEEDS:
        arm = JointPlant(cell, LAGS[cell])
        assert arm.start() == Reason.NONE
        arm.sweep(speed, 2.0)
        arm.worst = 0.0
        arm.step(**broken(arm))
        assert (arm.out.state, arm.out.reason) == (State.FAULT, reason)
        for _ in range(150):
            arm.step()
        assert np.abs(arm.qd).max() < 1e-6, "it comes to rest"
        worst = max(worst, arm.worst)
    print(f"{cell}, {way}: {worst:.3f} of the acceleration limit")
    assert worst <= 1.0 + 1e-6


BROKEN_JOINTS: dict[str, Callable[[float, float, float], float]] = {
    "wraps": lambda q, t, frozen: q - 2 * np.pi,
    "jumps": lambda q, t, frozen: q + 0.1,
    "drifts": lambda q, t, frozen: q + 0.6 * t,
    "freezes": lambda q, t, frozen: frozen,
}
"""Measured position of a joint: of its true one, the time since it broke [s] and where it was."""


@pytest.mark.parametrize("cell", ROBOTS)
@pytest.mark.parametrize("kind", BROKEN_JOINTS)
def test_a_joint_that_cannot_be_there_is_never_followed(cell: str, kind: str) -> None:
    for joint in range(6):
        arm = JointPlant(cell, LAGS[cell])
        assert arm.start() == Reason.NONE
        arm.sweep(0.15, 2.1)
        frozen, begun = arm.measured()[joint], arm.time
        if kind == "freezes" and abs(arm.qd[joint]) < 0.15:
            continue  # it stands nearly still anyway
        arm.worst, speed, seen = 0.0, [], None
        for k in range(300):
            q = arm.measured()
            t = arm.time - begun
            q[joint] = BROKEN_JOINTS[kind](q[joint], t, frozen)
            if seen is None:
                arm.step(sideways(0.15, 2.1 + t), q=q)
                seen = k if arm.out.state == State.FAULT else None
            else:
                arm.step(q=q)
                speed.append(float(np.abs(arm.out.qd_command / arm.most).max()))
        where = f"{cell}, joint {joint + 1} {kind}"
        assert seen is not None, where
        # A joint that freezes or drifts slowly takes the measured shaft off the trocar first.
        slow = kind in ("freezes", "drifts") and arm.out.reason == Reason.RCM_ERROR
        assert arm.out.reason == Reason.STATE_IMPLAUSIBLE or slow, where
        assert np.diff(speed).max() <= 1e-12, f"{where}: faster after FAULT"
        assert speed[-1] == 0.0, where
        assert arm.worst <= 1.0 + 1e-6, where


@pytest.mark.parametrize("cell", ROBOTS)
def test_single_glitches_are_passed_over(cell: str) -> None:
    arm = JointPlant(cell, LAGS[cell])
    assert arm.start() == Reason.NONE
    arm.sweep(0.1, 1.0)
    rng = np.random.default_rng(1)
    far = 0.0
    for k in range(1000):
        q = arm.measured()
        if k % 50 == 10:
            q[rng.integers(len(q))] += rng.choice([-2 * np.pi, 0.3, 2 * np.pi])
        arm.step(sideways(0.1, 1.0 + k * T), q=q)
        far = max(far, arm.out.rcm_error)
    assert arm.out.state == State.ENABLED
    assert far < 1e-4
    assert arm.worst <= 1.0 + 1e-6


def test_after_a_lost_state_the_arm_is_enabled_again() -> None:
    arm = JointPlant()
    arm.start()
    for _ in range(20):
        arm.step(q=arm.measured() + 0.5 * (np.arange(6) == 2))
    assert (arm.out.state, arm.out.reason) == (State.FAULT, Reason.STATE_IMPLAUSIBLE)
    for _ in range(50):
        arm.step()
    assert arm.controller.request(StateCommand.ENABLE) == Reason.NONE


@pytest.mark.parametrize("turns", [-1, 2])
def test_a_start_outside_the_joint_limits_is_refused(turns: int) -> None:
    arm = JointPlant()
    arm.q[5] += turns * 2 * np.pi
    assert arm.start() == Reason.JOINT_OUTSIDE
    assert arm.out.state == State.DISABLED


def between(q: np.ndarray, room: np.ndarray, cell: str) -> surg_core.RobotConfig:
    """The robot of a cell whose joints may only go so far (n,) [rad] from q (n,)."""
    document = surg_core.read_document(shipped(cell).robot.file)
    values = dict(document.values)
    values["joints.position_min"] = list(q - room)
    values["joints.position_max"] = list(q + room)
    return surg_core._core.parse_robot(surg_core._core.Document(document.file, values))


@pytest.mark.parametrize("cell", ROBOTS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_shaking_hand_that_presses_on_a_joint_limit_has_one_reason(cell: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = JointPlant(cell)
    a, joints = arm.arm, len(arm.q)
    robot = between(arm.q, rng.uniform(0.05, 0.2, joints), cell)
    arm.controller = Controller(a.chain, robot, a.limits, a.instrument, a.tool)
    arm.controller.set_rcm(np.asarray(a.trocar.p_BRcm))
    assert arm.start() == Reason.NONE
    rest, goal = np.array([0, 0, 0.12, 0]), np.array([0.6, -0.5, 0.06, 1.0]) * rng.choice([-1, 1])
    goal[2] = 0.06
    tremor, hz = np.array([2e-3, 2e-3, 2e-4, 0.01]), rng.uniform(4, 12)
    reasons = []
    for k in range(2000):
        way = min(k / 750, 1.0)
        hand = rest + way * (goal - rest) + way * tremor * np.sin(2 * np.pi * hz * k * T)
        reasons.append(arm.step(MotionCommand(Motion.SERVO_JP, 1, joints=hand)).reason)
    assert set(reasons) == {Reason.NONE, Reason.UNREACHABLE}
    assert sum(a != b for a, b in itertools.pairwise(reasons)) <= 3


# --- time, not calls ----------------------------------------------------------------------------


@pytest.mark.parametrize("cell", ROBOTS)
def test_a_caller_at_four_times_the_rate_moves_no_faster(cell: str) -> None:
    took = {}
    for dt in (T, T / 4):
        arm = JointPlant(cell)
        arm.start()
        arm.worst, begun = 0.0, arm.time
        arm.step(pose([0.03, 0.0, 0.12], motion=Motion.MOVE_CP))
        while arm.out.busy and arm.time - begun < 5.0:
            arm.step(dt=dt, elapsed=dt)
        took[dt] = arm.time - begun
        assert arm.out.state == State.ENABLED, arm.out.reason
        assert np.linalg.norm(arm.tip() - [0.03, 0.0, 0.12]) < 1e-3
        assert arm.worst <= 1.0 + 1e-6
    assert took[T / 4] == pytest.approx(took[T], abs=0.02)


def test_an_overtaken_sample_does_not_count() -> None:
    """Stamps tell the order; as many samples as arrive late change nothing."""
    paths = []
    for late in (False, True):
        arm = JointPlant()
        arm.start()
        rng = np.random.default_rng(3)
        path = []
        for k in range(1500):
            t = k * T
            stamp = 1_000_000_000 + round(1e9 * t)
            commands = []
            if k % 5 == 0:
                commands.append(pose([0.02 * np.sin(3 * t), 0.0, 0.12], stamp_ns=stamp))
            elif late and k > 500 and rng.random() < 0.2:
                before = t - rng.uniform(0.01, 0.04)
                place = [0.02 * np.sin(3 * before), 0.0, 0.12]
                commands.append(pose(place, stamp_ns=stamp - round(1e9 * (t - before))))
            arm.step(*commands)
            path.append(arm.tip())
        assert arm.out.state == State.ENABLED
        paths.append(np.array(path))
    assert np.abs(paths[0] - paths[1]).max() < 1e-4


def test_a_command_that_is_withheld_is_said() -> None:
    arm = JointPlant()
    arm.start()
    arm.sweep(0.1, 0.5)
    assert not arm.out.withheld
    for _ in range(8):
        arm.step(dt=0.012, elapsed=0.012)
    assert arm.out.withheld
