"""`./surg emulate` starts an emulator, tells its ports, and refuses wrong options."""

from collections.abc import Callable

import pytest

from helpers.hardware.emulated_ur import free_address
from surg_cli.host.terminal import Problem
from surg_hardware.emulators import emulator_ports
from surg_hardware.emulators.ur import ur_emulator


@pytest.fixture(autouse=True)
def _without_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test's own process must stay as it is."""
    monkeypatch.setattr(emulator_ports, "ask_real_time", lambda: False)


@pytest.mark.parametrize(
    ("arm", "model", "port"),
    [
        ("ur", "UR5e", "rtde=30004"),
        ("fer", "Franka Emika Robot (Panda)", "command=1337"),
        ("fr3", "Franka Research 3", "command=1337"),
    ],
)
def test_it_runs_for_the_time_that_was_asked_for(
    arm: str, model: str, port: str, surg: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    address = free_address()
    assert surg("emulate", arm, "--address", address, "--seconds", "0.1") == 0
    said = capsys.readouterr().out
    assert f"Emulated {model}" in said
    assert address in said
    assert port in said


@pytest.mark.parametrize(
    ("arm", "option", "value"),
    [
        ("ur", "--address", "1.1.1.1"),
        ("ur", "--ports", "rtde"),
        ("ur", "--mishap", "/no"),
        ("fer", "--model", "UR10e"),
        ("fr3", "--q", "0.5"),
    ],
)
def test_wrong_options_end_with_2(
    arm: str, option: str, value: str, surg: Callable[..., int]
) -> None:
    address = [] if option == "--address" else ["--address", free_address()]
    with pytest.raises(Problem) as problem:
        surg("emulate", arm, option, value, *address)
    assert problem.value.code == 2
    assert option in str(problem.value) or value in str(problem.value)


def test_it_is_the_arm_of_a_cell(surg: Callable[..., int], monkeypatch: pytest.MonkeyPatch) -> None:
    asked = {}
    monkeypatch.setattr(ur_emulator, "start", lambda options: asked.update(vars(options)) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        surg("emulate", "ur", "--cell", "emulated_ur5e")
    assert (asked["address"], asked["serial"]) == ("127.0.0.1", "20225500001")
    assert asked["model"] == "UR5e"
    assert asked["q"] == pytest.approx([-0.294, -1.234, 1.511, -1.29, -1.63, -2.134])


def test_another_arm_than_the_cells_is_refused(surg: Callable[..., int]) -> None:
    with pytest.raises(Problem, match=r"arms.PSM1.robot: 'ur5e'; allowed: panda") as problem:
        surg("emulate", "fer", "--cell", "emulated_ur5e")
    assert problem.value.code == 2


def test_a_simulators_cell_has_no_arm_to_emulate(surg: Callable[..., int]) -> None:
    with pytest.raises(Problem, match=r"arms.PSM1.hardware.address") as problem:
        surg("emulate", "ur", "--cell", "sim_ur5e")
    assert problem.value.code == 2
