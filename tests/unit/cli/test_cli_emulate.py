"""`./surg emulate` starts an emulator, tells its ports, and refuses wrong options."""

from collections.abc import Callable

import pytest

from helpers.hardware.emulated_ur import free_address
from surg_cli.host.terminal import Problem
from surg_hardware.emulators.ur import ur_emulator


@pytest.fixture(autouse=True)
def _without_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test's own process must stay as it is."""
    monkeypatch.setattr(ur_emulator, "ask_real_time", lambda: False)


def test_it_runs_for_the_time_that_was_asked_for(
    surg: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    address = free_address()
    assert surg("emulate", "ur", "--address", address, "--seconds", "0.1") == 0
    said = capsys.readouterr().out
    assert f"Emulated UR5e on {address}" in said
    assert "rtde=30004" in said


@pytest.mark.parametrize(
    ("option", "value"), [("--address", "1.1.1.1"), ("--ports", "rtde"), ("--mishap", "/no")]
)
def test_wrong_options_end_with_2(surg: Callable[..., int], option: str, value: str) -> None:
    address = [] if option == "--address" else ["--address", free_address()]
    with pytest.raises(Problem) as problem:
        surg("emulate", "ur", option, value, *address)
    assert problem.value.code == 2
    assert value in str(problem.value)


def test_it_is_the_arm_of_a_cell(surg: Callable[..., int], monkeypatch: pytest.MonkeyPatch) -> None:
    asked = {}
    monkeypatch.setattr(ur_emulator, "start", lambda options: asked.update(vars(options)) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        surg("emulate", "ur", "--cell", "emulated_ur5e")
    assert (asked["address"], asked["serial"]) == ("127.0.0.1", "20225500001")
    assert asked["model"] == "UR5e"
    assert asked["q"] == pytest.approx([-0.294, -1.234, 1.511, -1.29, -1.63, -2.134])


def test_a_simulators_cell_has_no_arm_to_emulate(surg: Callable[..., int]) -> None:
    with pytest.raises(Problem, match=r"arms.PSM1.hardware.address") as problem:
        surg("emulate", "ur", "--cell", "sim_ur5e")
    assert problem.value.code == 2
