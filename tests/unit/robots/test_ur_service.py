"""`./surg robot CELL on|off|recover` against the emulated arm: a person is asked, nothing moves."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from helpers.hardware import emulated_ur
from helpers.hardware.emulated_cell import HOME, SERIAL, emulated_cell
from surg_cli.host.terminal import CliError
from surg_emulators.ur import ur_controller
from surg_emulators.ur.robot_states import RobotMode, SafetyMode
from surg_emulators.ur.ur_controller import UrController

Robot = Callable[..., int]


@pytest.fixture
def controller(monkeypatch: pytest.MonkeyPatch) -> UrController:
    """An arm that is off, with short times."""
    monkeypatch.setattr(ur_controller, "POWER_TIME", 0.02)
    return UrController(serial=SERIAL, q=HOME, ready=False)


@pytest.fixture
def robot(
    controller: UrController,
    surg: Callable[..., int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Robot]:
    """Runs `./surg robot CELL ACTION`, with a person's answer."""
    with emulated_ur.in_process(controller) as emulator:
        cell = emulated_cell(tmp_path, emulator.address)

        def run(action: str, answer: str = "yes") -> int:
            monkeypatch.setattr("sys.stdin", io.StringIO(f"{answer}\n"))
            return surg("robot", str(cell), action)

        yield run
        assert controller.motion.actual_q == list(HOME), "nothing has moved"


def test_power_and_brakes_on_and_off(robot: Robot, controller: UrController) -> None:
    assert robot("on") == 0
    assert controller.robot_mode == RobotMode.RUNNING
    assert robot("on") == 0, "a second time changes nothing"
    assert robot("off") == 0
    assert controller.robot_mode == RobotMode.POWER_OFF


@pytest.mark.parametrize("answer", ["no", "", "y", "YES!"])
def test_without_a_yes_nothing_happens(robot: Robot, controller: UrController, answer: str) -> None:
    with pytest.raises(CliError, match="not confirmed"):
        robot("on", answer)
    assert controller.robot_mode == RobotMode.POWER_OFF


def test_local_control_is_named(robot: Robot, controller: UrController) -> None:
    controller.remote = False
    with pytest.raises(CliError, match="local control"):
        robot("on")
    assert controller.robot_mode == RobotMode.POWER_OFF


def test_a_protective_stop_is_unlocked_after_its_time(
    robot: Robot, controller: UrController, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert robot("on") == 0
    controller.protective_stop("test")
    with pytest.raises(CliError, match="wait 5 s"):
        robot("recover")
    assert controller.safety_mode == SafetyMode.PROTECTIVE_STOP
    monkeypatch.setattr(ur_controller, "UNLOCK_AFTER", 0.0)
    assert robot("recover") == 0
    assert controller.safety_mode == SafetyMode.NORMAL
    assert robot("recover") == 0, "there is nothing to recover from"


def test_a_violation_restarts_the_safety_system_and_an_estop_is_released_by_hand(
    robot: Robot, controller: UrController
) -> None:
    assert robot("on") == 0
    controller.fall_to(SafetyMode.ROBOT_EMERGENCY_STOP, "test")
    for action in ("recover", "on"):
        with pytest.raises(CliError, match=r"button|recover"):
            robot(action)
    controller.release()
    controller.fall_to(SafetyMode.VIOLATION, "test")
    assert robot("recover") == 0
    assert controller.safety_mode == SafetyMode.NORMAL
    assert robot("on") == 0


def test_an_arm_that_does_not_answer_is_sent_to_the_doctor(
    surg: Callable[..., int], tmp_path: Path
) -> None:
    cell = emulated_cell(tmp_path, emulated_ur.free_address())
    with pytest.raises(CliError, match="surg robot cell doctor"):
        surg("robot", str(cell), "kinematics")
    with pytest.raises(CliError, match="'simulator'") as problem:
        surg("robot", "sim_ur5e", "off")
    assert problem.value.code == 2
