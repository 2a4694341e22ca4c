"""`./surg emulate` starts an emulator, tells its ports, and refuses wrong options."""

from collections.abc import Callable
from types import ModuleType

import pytest

import surg_core
from helpers.hardware.emulated_ur import free_address
from surg_cli.host import paths
from surg_cli.host.terminal import Problem
from surg_emulators import emulator_ports
from surg_emulators.franka import franka_emulator
from surg_emulators.ur import ur_emulator


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
        ("ur", "--faults", "/no"),
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


@pytest.mark.parametrize(
    ("arm", "cell", "module"),
    [
        ("ur", "emulated_ur5e", ur_emulator),
        ("fer", "emulated_panda", franka_emulator),
        ("fr3", "emulated_fr3", franka_emulator),
    ],
)
def test_it_is_the_arm_of_a_cell(
    arm: str,
    cell: str,
    module: ModuleType,
    surg: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = {}
    monkeypatch.setattr(module, "start", lambda *given: asked.update(vars(given[-1])) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        surg("emulate", arm, "--cell", cell)
    wanted = surg_core.load_cell(paths.CELLS / cell).arms["PSM1"]
    assert (asked["address"], asked["serial"]) == (
        wanted.hardware.address,
        wanted.hardware.serial,
    )
    assert str(asked["model"]).lower() == wanted.robot.name
    assert asked["q"] == pytest.approx(wanted.robot.home)


def test_another_arm_than_the_cells_is_refused(surg: Callable[..., int]) -> None:
    with pytest.raises(Problem, match=r"arms.PSM1.robot: 'ur5e'; allowed: panda") as problem:
        surg("emulate", "fer", "--cell", "emulated_ur5e")
    assert problem.value.code == 2


def test_a_simulators_cell_has_no_arm_to_emulate(surg: Callable[..., int]) -> None:
    with pytest.raises(Problem, match=r"arms.PSM1.hardware.address") as problem:
        surg("emulate", "ur", "--cell", "sim_ur5e")
    assert problem.value.code == 2
