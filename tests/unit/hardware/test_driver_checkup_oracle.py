"""`./surg robot CELL doctor` on emulated Franka arms with things wrong, by the makers' libraries.

The doctor starts the arm's own driver, which moves nothing.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import surg_core
from helpers.hardware import emulated_franka
from helpers.hardware.emulated_cell import emulated_cell
from helpers.hardware.emulated_ur import fault, free_address
from surg_cli.host import link_environments
from surg_cli.robots import robot_doctor
from surg_hardware.checkup import Finding
from surg_hardware.driver_process import alone

pytestmark = pytest.mark.oracle

KINDS = {"panda": "fer", "fr3": "fr3"}
NOTHING = {"mass": 0.0, "cog": [0.0, 0.0, 0.0]}
WRONG = {
    "user_stop on": ("condition", "release the external activation device"),
    "brakes close": ("condition", "release them in Desk"),
    "guide on": ("condition", "end it"),
    "collision 3": ("condition", "recover"),
    "reflex cartesian_reflex": ("condition", "recover"),
    "mode 99": ("condition", "Desk"),
    "load 0.9": ("hardware.payload.mass", "set"),
    "load 0.09 0 0 0.1": ("hardware.payload.cog", "set"),
    "nan on": ("condition", "check power"),
}
"""Fault -> the line that names it, and words of its cure."""


@pytest.fixture(params=KINDS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(autouse=True)
def environment(name: str) -> None:
    link_environments.make_ready(surg_core.load_cell(emulated(name)).arms["PSM1"])


def emulated(name: str) -> Path:
    return robot_doctor.cells.find(f"emulated_{name}")


def bad(folder: Path) -> list[Finding]:
    lines = robot_doctor.findings(str(folder), None, 0.3)
    return [line for line in lines if line.good is False]


def test_what_is_wrong_is_named_with_its_cure(name: str, tmp_path: Path) -> None:
    home = surg_core.load_cell(emulated(name)).arms["PSM1"].robot.home
    at = [f"{angle:.6f}" for angle in home]
    for number, (line, (what, cure)) in enumerate(({"": ("", "")} | WRONG).items()):
        folder = tmp_path / str(number)
        folder.mkdir()
        with emulated_franka.program(KINDS[name], folder / "log", "--q", *at) as address:
            if line:
                assert fault(address, line) == "ok"
            found = bad(emulated_cell(folder, address, name, payload=NOTHING))
        print(f"{name}, {line}: {[(each.what, each.text, each.cure) for each in found]}")
        assert [each.what for each in found] == ([f"PSM1: {what}"] if what else [])
        assert all(each.text and cure in each.cure for each in found)


def test_nobody_another_model_and_a_robot_that_is_driven_are_told_apart(
    name: str, tmp_path: Path
) -> None:
    (nobody,) = bad(emulated_cell(tmp_path / "nobody", free_address(), name))
    (other,) = set(KINDS.values()) - {KINDS[name]}
    with emulated_franka.program(other, tmp_path / "log") as address:
        (foreign,) = bad(emulated_cell(tmp_path / "foreign", address, name))
        with alone(address):
            (driven,) = bad(emulated_cell(tmp_path / "driven", address, name))
    for found in (nobody, foreign, driven):
        print(f"{name}: {found.what}: {found.text}: {found.cure}")
        assert found.what == "PSM1: hardware.address" and found.cure
    assert "another driver" in driven.text
    assert "write link: " in foreign.text
    assert len({nobody.text, foreign.text, driven.text}) == 3
