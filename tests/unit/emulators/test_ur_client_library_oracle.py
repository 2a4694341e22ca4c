"""The maker's client library drives the emulated UR arm: its examples and tests, as they are."""

import json
from pathlib import Path

import pytest

from helpers.hardware import emulated_ur, ur_client_library

pytestmark = pytest.mark.oracle
WAIT = "def wait_program():\n  while True:\n    sync()\n  end\nend\n"
"""A program that the examples expect on the robot."""
EXAMPLES = {
    "driver_example": (),
    "trajectory_point_interface_example": (),
    "trajectory_streaming_example": (),
    "spline_example": (),
    "freedrive_example": ("2",),
    "script_command_interface_example": ("2",),
    "send_script": (),
    "primary_pipeline_example": ("2",),
    "primary_pipeline_calibration_example": (),
    "rtde_client_example": ("2",),
    "external_fts_through_rtde": ("2",),
    "dashboard_example": (),
    "tool_contact_example": ("2",),
    "instruction_executor": (),
}
"""Example -> its words. Forces and torques are not emulated: force_mode, direct_torque_control. The
`optimove`s of instruction_executor are for later versions, and skipped by its program."""
LONGEST = 300.0
"""[s] Of an example or a program of tests; the longest moves for a minute."""
MOVING = (
    "driver_example",
    "trajectory_point_interface_example",
    "spline_example",
    "tool_contact_example",
    "instruction_executor",
)
TESTS = {
    "primary_client_test_headless": ("PrimaryClientFakeTest.*",),
}
"""Tests that the library means for a simulator -> those left out: they have a server of their own,
at an address that the emulator cannot have."""


@pytest.fixture(autouse=True)
def time_limit() -> None:
    """An example has a limit of its own."""


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_of_the_maker_passes(name: str, tmp_path: Path) -> None:
    program = tmp_path / "wait_program.urp"
    program.write_text(WAIT)
    with emulated_ur.program(tmp_path / "emulator.log") as address:
        assert emulated_ur.fault(address, f"load {program}") == "ok"
        before = json.loads(emulated_ur.fault(address, "status"))["q"]
        try:
            ur_client_library.example(name, address, *EXAMPLES[name], timeout=LONGEST)
        finally:
            print((tmp_path / "emulator.log").read_text("utf-8")[-3000:])
        status = json.loads(emulated_ur.fault(address, "status"))
    assert status["safety_mode"] == "NORMAL"
    if name in MOVING:
        assert status["q"] != pytest.approx(before, abs=1e-3), "the arm has moved"


def test_a_push_is_a_contact(tmp_path: Path) -> None:
    program = tmp_path / "wait_program.urp"
    program.write_text(WAIT)
    with emulated_ur.program(tmp_path / "emulator.log") as address:
        assert emulated_ur.fault(address, f"load {program}") == "ok"
        assert emulated_ur.fault(address, "push 0 0 40") == "ok"
        said = ur_client_library.example("tool_contact_example", address, "5")
    assert "Tool contact result: 0" in said


@pytest.mark.parametrize("name", TESTS)
def test_its_own_tests_pass(name: str, tmp_path: Path) -> None:
    program = tmp_path / "wait_program.urp"
    program.write_text(WAIT)
    with emulated_ur.program(tmp_path / "emulator.log") as address:
        assert emulated_ur.fault(address, f"load {program}") == "ok"
        try:
            said = ur_client_library.its_tests(name, address, TESTS[name], LONGEST)
        finally:
            print((tmp_path / "emulator.log").read_text("utf-8")[-3000:])
    assert "[  PASSED  ]" in said and "0 tests." not in said
