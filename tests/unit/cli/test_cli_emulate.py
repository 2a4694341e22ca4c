"""`./surg emulate` starts an emulator, tells its ports, and refuses wrong options."""

from collections.abc import Callable
from types import ModuleType

import pytest

import surg_core
from helpers.hardware.emulated_ur import free_address
from surg_cli.commands.arms import emulate
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_emulators import emulator_ports, emulator_program
from surg_emulators.franka import franka_emulator
from surg_emulators.ur import ur_emulator


@pytest.fixture(autouse=True)
def _without_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test's own process must stay as it is."""
    monkeypatch.setattr(emulator_program, "ask_real_time", lambda: False)


@pytest.fixture
def _briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends by itself."""
    run = emulator_ports.PortedEmulator.run
    monkeypatch.setattr(
        emulator_ports.PortedEmulator, "run", lambda self, _, tell: run(self, 0.1, tell=tell)
    )


@pytest.mark.parametrize(
    ("robot", "model", "port"),
    [
        ("ur5e", "UR5e", "rtde=30004"),
        ("ur10e", "UR10e", "rtde=30004"),
        ("panda", "Franka Emika Robot (Panda)", "command=1337"),
        ("fr3", "Franka Research 3", "command=1337"),
    ],
)
@pytest.mark.usefixtures("_briefly")
def test_it_runs_and_tells_its_ports(
    robot: str, model: str, port: str, surg: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    address = free_address()
    assert surg("emulate", robot, "--address", address) == 0
    said = capsys.readouterr().out
    assert f"Emulated {model}" in said
    assert address in said
    assert port in said


@pytest.mark.parametrize(
    "words",
    [
        ("ur5e", "--address", "1.1.1.1"),
        ("ur5e", "--faults", "/no", "--address", free_address()),
        ("fr3", "--arm", "PSM1"),
        ("nothing",),
        ("emulated_ur5e", "--address", "127.0.0.2"),
        ("emulated_ur5e", "--arm", "PSM9"),
    ],
)
def test_wrong_options_end_with_2(words: tuple[str, ...], surg: Callable[..., int]) -> None:
    with pytest.raises(CliError) as problem:
        surg("emulate", *words)
    assert problem.value.code == 2
    assert any(word in str(problem.value) for word in words[1:] or words)


@pytest.mark.parametrize(("old", "new"), [("ur", "ur5e"), ("fer", "panda")])
def test_an_old_name_answers_with_the_new_one(old: str, new: str, surg: Callable[..., int]) -> None:
    with pytest.raises(CliError, match=f"emulate {old} is now {new}") as problem:
        surg("emulate", old)
    assert problem.value.code == 2


@pytest.mark.parametrize(
    ("cell", "module"),
    [
        ("emulated_ur5e", ur_emulator),
        ("emulated_panda", franka_emulator),
        ("emulated_fr3", franka_emulator),
    ],
)
def test_it_is_the_arm_of_a_cell(
    cell: str,
    module: ModuleType,
    surg: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = {}
    monkeypatch.setattr(module, "start", lambda *given: asked.update(vars(given[-1])) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        surg("emulate", cell)
    wanted = surg_core.load_cell(paths.CELLS / cell).arms["PSM1"]
    assert (asked["address"], asked["serial"]) == (
        wanted.hardware.address,
        wanted.hardware.serial,
    )
    assert str(asked["model"]).lower() == wanted.robot.name
    assert asked["q"] == pytest.approx(wanted.robot.home)


def test_a_robot_without_an_emulator_is_refused(
    surg: Callable[..., int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(emulate.ROBOTS, "ur5e")
    with pytest.raises(CliError, match=r"arms.PSM1.robot: 'ur5e'; allowed: ur3e") as problem:
        surg("emulate", "emulated_ur5e")
    assert problem.value.code == 2


def test_a_simulators_cell_has_no_arm_to_emulate(surg: Callable[..., int]) -> None:
    with pytest.raises(CliError, match=r"arms.PSM1.hardware.address") as problem:
        surg("emulate", "sim_ur5e")
    assert problem.value.code == 2
