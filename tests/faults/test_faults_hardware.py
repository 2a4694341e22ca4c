"""F33 behind the link to a UR arm: the emulated robot stops by itself, and nothing leaps later.

Exact in cycles, on a made-up clock; judged by the emulated arm's own joints.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable

import numpy as np
import pytest

from helpers.hardware.emulated_chain import Chain
from helpers.results.reactions import Reactions
from surg_core import Reason, State, StateCommand
from surg_emulators.ur.robot_states import SafetyMode
from surg_emulators.ur.ur_controller import UrController
from surg_hardware.conditions import Condition

pytestmark = pytest.mark.untimed

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
SPEEDS = {"scale 1": 0.012, "scale 0.1": 0.0012}
"""[m/s] Of the tip: the bundled motion at the stop, and a tenth of it."""
STOPS: dict[str, tuple[Callable[[UrController], object], Condition]] = {
    "protective stop": (lambda c: c.protective_stop("test"), Condition.STOPPED),
    "safeguard stop": (lambda c: c.safeguard(True), Condition.STOPPED),
    "emergency stop": (
        lambda c: c.fall_to(SafetyMode.ROBOT_EMERGENCY_STOP, "test"), Condition.ESTOP,
    ),
    "violation": (lambda c: c.fall_to(SafetyMode.VIOLATION, "test"), Condition.BROKEN),
    "power off": (lambda c: c.power_off(), Condition.OFF),
    "hand on the arm": (lambda c: c.guide(True, [0.0] * 6), Condition.GUIDED),
    "program stopped": (lambda c: c.stop(), Condition.READY),
    "program paused": (lambda c: c.pause(), Condition.STOPPED),
}  # fmt: skip


@pytest.mark.parametrize("what", STOPS)
@pytest.mark.parametrize("scale", SPEEDS)
def test_robot_condition_a_stop_faults_within_three_cycles(
    reactions: Reactions, scale: str, what: str
) -> None:
    stop, condition = STOPS[what]
    chain = Chain()
    for _ in range(150):
        assert chain.stream(SPEEDS[scale]).state == State.ENABLED
    stop(chain.robot)
    cycles = 0
    while chain.stream(SPEEDS[scale]).state == State.ENABLED:
        cycles += 1
        assert cycles < 100, "nobody noticed"
    assert chain.out.reason == Reason.ROBOT
    assert not np.any(chain.out.qd_command)
    assert chain.status is not None and chain.status.condition is condition
    assert chain.status.fault
    for word in (StateCommand.ENABLE, StateCommand.HOME):
        assert chain.controller.request(word) == Reason.ROBOT
    most = 3 if condition is not Condition.READY else 10
    reactions.add("F33", f"emulated UR, {what}, {scale}", "FAULT(robot)", [cycles], most)


def test_robot_condition_a_slider_is_ramped_and_latched(reactions: Reactions) -> None:
    chain = Chain()
    for _ in range(150):
        chain.stream(0.012)
    chain.robot.slider = 0.5
    away = 0.0
    for _ in range(400):
        chain.stream(0.012)
        away = max(away, chain.deviation)
    assert (chain.out.state, chain.out.reason) == (State.FAULT, Reason.ROBOT)
    chain.robot.slider = 1.0
    rest = chain.tip
    chain.run(500)
    assert chain.status is not None and chain.status.condition is Condition.READY
    assert np.array_equal(chain.tip, rest)
    reactions.add("F33", "emulated UR, slider 50 %", "deviation", [1e3 * away], 0.2, "mm")


def unlocked(chain: Chain) -> None:
    assert chain.robot.unlock()


def powered(chain: Chain) -> None:
    chain.robot.release()
    chain.robot.release_brakes()


def let_go(chain: Chain) -> None:
    chain.robot.safeguard(False)
    chain.robot.guide(False)


def played(chain: Chain) -> None:
    """In local control: the link may not end the program, so a person can resume it."""
    assert chain.robot.safety_mode == SafetyMode.NORMAL or chain.robot.unlock()
    assert chain.robot.play()


RECOVERIES: dict[str, tuple[Callable[[Chain], object], Callable[[Chain], None]]] = {
    "protective stop, unlocked": (lambda c: c.robot.protective_stop("test"), unlocked),
    "protective stop, unlocked and played": (lambda c: c.robot.protective_stop("test"), played),
    "pause, played": (lambda c: c.robot.pause(), played),
    "emergency stop, released": (
        lambda c: c.robot.fall_to(SafetyMode.ROBOT_EMERGENCY_STOP, "test"), powered,
    ),
    "reboot": (lambda c: c.ur.reboot(600), powered),
    "safeguard stop, reset": (lambda c: c.robot.safeguard(True), let_go),
    "hand on the arm, let go": (lambda c: c.robot.guide(True, [0.0] * 6), let_go),
    "program stopped": (lambda c: c.robot.stop(), let_go),
}  # fmt: skip
"""What stops the robot, and what people then do."""


@pytest.mark.parametrize("scale", SPEEDS if FULL else ["scale 0.1"])
@pytest.mark.parametrize("what", RECOVERIES)
def test_after_a_stop_and_a_start_nothing_moves_until_a_person_enables(
    reactions: Reactions, scale: str, what: str
) -> None:
    """The sender and the controller go on as if nothing had happened."""
    stop, recover = RECOVERIES[what]
    before, after = [], []
    for seed in range((100 if scale == "scale 0.1" else 10) if FULL else 1):
        rng = np.random.default_rng(seed)
        chain = Chain()
        chain.ur.dashboard = recover is not played
        for _ in range(int(rng.integers(100, 400))):
            assert chain.stream(SPEEDS[scale]).state == State.ENABLED
        stop(chain)
        for _ in range(2600 + int(rng.integers(0, 200))):
            chain.stream(SPEEDS[scale])
        rest, farthest = chain.tip, 0.0
        recover(chain)
        started = False
        for cycle in range(1800):
            started = started or (cycle >= 1100 and chain.start() == "")
            assert chain.stream(SPEEDS[scale]).state == State.FAULT
            farthest = max(farthest, 1e3 * float(np.linalg.norm(chain.tip - rest)))
        before.append(farthest)
        assert started and chain.status is not None
        assert chain.status.condition is Condition.ACTIVE, chain.status
        assert chain.controller.request(StateCommand.ENABLE) == Reason.NONE
        for _ in range(300):
            assert chain.step().state == State.ENABLED
        after.append(1e3 * float(np.linalg.norm(chain.tip - rest)))
    name = f"emulated UR, {what}, started, {scale}"
    reactions.add("F33", name, "tip before enable", before, 0.0005, "mm")
    reactions.add("F33", name, "tip after enable", after, 0.1, "mm")


@pytest.mark.parametrize("scale", SPEEDS)
def test_an_arm_that_stands_still_while_its_link_says_active_is_noticed(
    reactions: Reactions, scale: str
) -> None:
    chain = Chain()
    chain.moves = False
    cycles, speed = 0, SPEEDS[scale]
    while chain.out.state == State.ENABLED:
        cycles += 1
        chain.stream(speed * math.cos(speed * cycles * 0.002 / 0.004))
        assert cycles < 2000, "nobody noticed"
    assert chain.out.reason in (Reason.NOT_FOLLOWING, Reason.RCM_ERROR)
    most = 0.5 if scale == "scale 1" else 1.5
    name = f"emulated UR stands still, {scale}"
    reactions.add("F33", name, "PAUSED(not_following)", [0.002 * cycles], most, "s")
