"""Controller, driver and emulated Franka arms on a made-up clock: pivot, loss, stops.

The emulator ends a motion by a reflex where a velocity, acceleration or jerk is above Franka's
limits. ``SURG_TEST_FULL=1`` plays the whole bundled motion.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
import pytest

from helpers.hardware.chain_player import Played, play
from helpers.hardware.franka_chain import Chain
from helpers.results import hardware_results as page
from surg_cli.host import paths
from surg_core import Motion, MotionCommand, Reason, State, StateCommand
from surg_emulators.franka.franka_controller import FrankaController, RobotMode
from surg_emulators.franka.franka_errors import Error
from surg_hardware.conditions import Condition
from surg_hardware.shaper import Shaper
from surg_teleop.playback.motion_player import PlayerStage

pytestmark = pytest.mark.untimed

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
BUNDLED = paths.ROOT / "src/surg_teleop/motions/bundled.csv"
SECONDS = 60.0 if FULL else 1.4
OFF = 0.05
"""[mm] Largest deviation from the pivot."""
RUNS = [("panda", 0.0), ("panda", 0.002), ("fr3", 0.0), ("fr3", 0.002)]
"""Arm, and share of the commands that are lost."""


def bundled(name: str, patch: pytest.MonkeyPatch, loss: float) -> tuple[Chain, Played]:
    """The bundled motion, or its beginning, on an arm that loses commands."""
    chain = Chain(name, patch)
    chain.robot.loss = loss
    return chain, play(chain, BUNDLED, duration=SECONDS)


@pytest.mark.parametrize(("name", "loss"), RUNS if FULL else RUNS[1:3])
def test_the_bundled_motion_keeps_the_pivot_without_a_reflex(
    name: str, loss: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain, played = bundled(name, monkeypatch, loss)
    assert played.stage is PlayerStage.DONE, (played.reason, list(chain.core.messages))
    deviation = 1e3 * played.deviation
    said = f"mean {deviation.mean():.4f}, max {deviation.max():.3f} mm"
    page.note(page.franka(name, loss), 1, said)
    assert deviation.max() <= OFF
    assert chain.core.mode is RobotMode.MOVE


@pytest.mark.full
def test_an_acceleration_that_is_reported_late_keeps_the_pivot_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chain = Chain("fr3", monkeypatch)
    chain.robot.sluggish = 0.95
    played = play(chain, BUNDLED, duration=SECONDS)
    assert played.stage is PlayerStage.DONE, (played.reason, list(chain.core.messages))
    assert 1e3 * played.deviation.max() <= OFF


def test_without_the_shaper_the_arm_stops_by_a_reflex(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain("panda", monkeypatch)
    monkeypatch.setattr(Shaper, "shape", lambda self, wanted, q, dq_d, ddq_d: tuple(wanted))
    played = play(chain, BUNDLED, duration=10.0)
    assert played.stage is PlayerStage.FAILED and "robot" in played.reason
    assert chain.core.mode is RobotMode.REFLEX
    assert chain.state is not None and "discontinuity" in chain.state.status.fault


def user_stop(core: FrankaController) -> None:
    core.user_stop(True)


def reflex(core: FrankaController) -> None:
    core.reflex(Error.joint_reflex, "a test")


def brakes(core: FrankaController) -> None:
    core.brakes(False)


STOPS: dict[str, tuple[Callable[[FrankaController], None], Condition]] = {
    "user stop": (user_stop, Condition.ESTOP),
    "reflex": (reflex, Condition.STOPPED),
    "brakes": (brakes, Condition.BRAKED),
}


def enabled(name: str, patch: pytest.MonkeyPatch) -> Chain:
    """An arm that is started and whose controller is ENABLED."""
    chain = Chain(name, patch)
    for word in (StateCommand.HOME, StateCommand.ENABLE):
        assert chain.controller.request(word) == Reason.NONE, word
    chain.run(20)
    assert chain.out.state == State.ENABLED
    return chain


ROWS = [(name, what) for name in ("panda", "fr3") for what in STOPS]


@pytest.mark.parametrize(("name", "what"), ROWS if FULL else [ROWS[0], ROWS[2], ROWS[4]])
def test_a_stopped_robot_faults_the_controller_within_3_cycles_and_latches(
    name: str, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = enabled(name, monkeypatch)
    act, condition = STOPS[what]
    act(chain.core)
    cycles = 0
    while chain.out.state == State.ENABLED:
        cycles += 1
        assert cycles <= 3
        chain.step()
    assert chain.out.state == State.FAULT and chain.out.reason == Reason.ROBOT
    assert chain.state is not None and chain.state.status.condition is condition
    for word in (StateCommand.ENABLE, StateCommand.HOME):
        assert chain.controller.request(word) != Reason.NONE
    at = np.array(chain.joints)
    chain.core.user_stop(False)
    chain.core.brakes(True)
    chain.run(700)
    if what == "reflex":
        chain.ask("recover")
        chain.run(150)
    assert chain.state.status.condition is Condition.READY, chain.state.status
    chain.run(100)
    assert np.abs(np.array(chain.joints) - at).max() < 1e-9
    chain.ask("start")
    chain.run(100)
    assert chain.state.status.condition is Condition.ACTIVE, chain.notices
    assert np.abs(np.array(chain.joints) - at).max() < 1e-9, "it waits for a person to enable it"


STALLS = [("fr3", 20), ("fr3", 104), ("fr3", 40), ("panda", 24)]
"""Arm, and ms."""


def sweep(chain: Chain, hold: Callable[[], None]) -> tuple[float, float]:
    """A sideways motion at 50 mm/s with a fault in it.

    Returns:
        Largest deviation from the pivot, and how far the tip is from where it was sent [mm].
    """
    depth = float(np.linalg.norm(chain.out.p_set - chain.out.p_BRcm))
    x, away, home = 0.0, [], chain.tip
    for cycle in range(400):
        if cycle == 200:
            assert chain.out.state == State.ENABLED, chain.out.reason
            hold()
        x += 0.002 * 0.05 * min(cycle / 60, 1.0)
        p = [x, 0.0, depth]
        chain.step(MotionCommand(Motion.SERVO_CP, 1, p=p, rotation=[0, 0, 0, 1]))
        away.append(chain.deviation)
    behind = 1e3 * x - 1e3 * float(np.linalg.norm(chain.tip - home))
    return 1e3 * max(away), behind


@pytest.mark.parametrize(("name", "stall"), STALLS if FULL else STALLS[:2])
def test_a_driver_that_stands_still_ends_in_a_fault_that_names_it(
    name: str, stall: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process holds the driver up for so many ms; the arm stops by itself."""
    chain = enabled(name, monkeypatch)
    off, _ = sweep(chain, lambda: chain.hold_driver(stall))
    assert chain.state is not None
    print(f"{name}, {stall} ms: {off:.3f} mm, {chain.out.reason}, {chain.state.status.fault}")
    assert chain.out.state == State.FAULT
    assert chain.out.reason in (Reason.ROBOT, Reason.LINK_LOST)
    assert "the driver stood still" in chain.state.status.fault
    assert off <= 0.5


@pytest.mark.parametrize("pause", [12, 20, 28, 38])
@pytest.mark.parametrize("name", ["fr3", "panda"])
def test_a_simulator_that_stands_still_for_a_moment_goes_on(
    name: str, pause: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its clock stood still with it, so that no command was missed.

    38 ms at 50 mm/s are 1.9 mm; the follower makes up for them at 2 per second, in 0.4 s for half.
    """
    chain = enabled(name, monkeypatch)
    off, behind = sweep(chain, lambda: chain.hold_robot(pause))
    print(f"{name}, {pause} ms: {off:.3f} mm off the pivot, {behind:.2f} mm behind")
    assert chain.out.state == State.ENABLED and chain.core.mode is RobotMode.MOVE
    assert off <= 0.5 and behind < 1.2


def test_a_robot_that_stands_still_for_longer_ends_in_a_fault_that_names_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chain = enabled("fr3", monkeypatch)
    off, _ = sweep(chain, lambda: chain.hold_robot(60))
    assert chain.state is not None
    assert chain.out.state == State.FAULT and off <= 0.5
    assert "the robot stood still for 61 ms" in chain.state.status.fault


def test_a_guided_arm_goes_on_telling_its_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain("panda", monkeypatch)
    chain.ask("stop")
    chain.run(100)
    before = chain.joints[0]
    assert chain.core.guide(True, [0.1] + [0.0] * 6)
    chain.run(100)
    assert chain.state is not None and chain.state.status.condition is Condition.GUIDED
    assert chain.state.q[0] - before == pytest.approx(0.02, abs=1e-3)
    chain.ask("start")
    chain.run(10)
    assert chain.core.mode is RobotMode.GUIDING and "start" in chain.notices[-1]


def test_our_flange_is_the_makers(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain("fr3", monkeypatch)
    chain.ask("stop")
    chain.run(700)
    assert chain.identity is not None
    rows = np.array(chain.identity.said.flange).reshape(3, 4)
    ours = chain.arm.chain.forward(np.array(chain.identity.q))
    assert np.abs(rows - ours[:3]).max() < 1e-9


def test_a_push_is_felt_and_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = enabled("panda", monkeypatch)
    chain.core.push([3.0, 0.0, -2.0, 0.0, 0.1, 0.0])
    chain.run(10)
    assert chain.state is not None
    assert chain.state.wrench == (3.0, 0.0, -2.0, 0.0, 0.1, 0.0)
    assert chain.out.state == State.ENABLED
