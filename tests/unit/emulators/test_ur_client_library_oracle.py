"""The maker's client library drives the emulated UR arm: its examples and tests, as they are."""

import json
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from helpers.hardware import emulated_ur, ur_client_library
from helpers.results.hardware_results import note, urcl

pytestmark = pytest.mark.oracle
WAIT = "def wait_program():\n  while True:\n    sync()\n  end\nend\n"
"""A program that the examples expect on the robot."""
EXAMPLES = {
    "driver_example": (),
    "trajectory_point_interface_example": (),
    "trajectory_streaming_example": (),
    "spline_example": (),
    "freedrive_example": ("2",),
    "direct_torque_control_example": ("2",),
    "script_command_interface_example": ("2",),
    "script_sender_example": ("2",),
    "send_script": (),
    "primary_pipeline_example": ("2",),
    "primary_pipeline_calibration_example": (),
    "rtde_client_example": ("2",),
    "external_fts_through_rtde": ("2",),
    "dashboard_example": (),
    "instruction_executor": (),
}
"""Example -> its words. direct_torque_control skips itself on this version, as the `optimove`s of
instruction_executor do; nobody asks script_sender for its script."""
passed: set[str] = set()
"""Examples that have, in this run."""
LONGEST = 300.0
"""[s] Of an example or a test; the longest moves for a minute."""
MOVING = (
    "driver_example",
    "trajectory_point_interface_example",
    "spline_example",
    "instruction_executor",
)
REPORTS = "report files"
FILES = "program files"
OWN = "their own server"
EARLY = "early unlocking"
TESTS: dict[str, dict[str, dict[str, str]]] = {
    "driver": {
        "ur_driver_tests_headless": {},
        "ur_driver_deprecated_constructor_test": {},
        "external_control_program_tests_headless": {},
    },
    "splines": {"spline_tests_headless": {}},
    "streaming": {"trajectory_streaming_tests_headless": {}},
    "instructions": {"instruction_executor_test_headless": {}},
    "RTDE": {
        "rtde_tests": {
            "get_data_package_fake_server": OWN,
            "destroy_client_after_server_stops_sending": OWN,
            "reconnect_fake_server_background_read": OWN,
            "reconnect_fake_server_blocking_read": OWN,
            "test_initialization": OWN,
        }
    },
    "primary": {"primary_client_test_headless": {"PrimaryClientFakeTest": OWN}},
    "dashboard": {
        "dashboard_client_g5_tests": {
            "flight_report_and_support_file": REPORTS,
            "set_receive_timeout": REPORTS,
            "connect_non_running_robot": "192.168.56.123",
            "operational_mode": "orders in local control",
        }
    },
    "robot API": {
        "dashboard_client_x_tests": {
            "unlock_protective_stop": EARLY,
            "get_safety_mode": EARLY,
            "upload_program_from_file": FILES,
            "upload_and_update_program_from_file": FILES,
            "download_program": FILES,
            "microsecond_receive_timeout_makes_connect_fail": "slower answers",
        }
    },
}
"""Row -> programs -> their tests, or cases of tests, that are left out, and what they want."""


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
    passed.add(name)
    if len(passed) == len(EXAMPLES):
        note(urcl("examples"), len(passed), "exit 0; direct_torque_control skips itself")


@pytest.mark.parametrize("row", TESTS)
def test_its_own_tests_pass(row: str, tmp_path: Path) -> None:
    for name in ("wait_program", "wait_program.urp"):
        (tmp_path / name).write_text(WAIT)
    polyscope_x = row == "robot API"
    words = ["--polyscope", "x"] if polyscope_x else []
    count = skipped = 0
    left: list[str] = []
    with emulated_ur.program(tmp_path / "emulator.log", *words) as address:
        for name, test in its_row(row):
            count += 1
            wants = {part: TESTS[row][name].get(part) for part in test.split(".")}
            if why := next(filter(None, wants.values()), None):
                left.append(why)
                continue
            if not polyscope_x or "interaction" in test:  # at first nothing is loaded in X
                program = tmp_path / ("wait_program" if polyscope_x else "wait_program.urp")
                assert emulated_ur.fault(address, f"load {program}") == "ok"
            skipped += not passes(name, test, address)
    good = count - skipped - len(left)
    assert good
    said = ["pass" if good == count else f"{good} pass"]
    said += [f"{skipped} skipped"] if skipped else []
    wanted = [f"{what} ({n})" for what, n in Counter(left).items()]
    said += [f"wanted: {', '.join(wanted)}"] if wanted else []
    note(urcl(row), count, "; ".join(said))


def its_row(row: str) -> list[tuple[str, str]]:
    """Programs of a row and their tests."""
    return [(name, test) for name in TESTS[row] for test in ur_client_library.its_tests(name)]


def passes(name: str, test: str, address: str) -> bool:
    """Whether a test passes, not skips itself; once more where it fails, as clients may be late."""
    try:
        return ur_client_library.its_test(name, test, address, LONGEST / 5)
    except (AssertionError, subprocess.TimeoutExpired):
        return ur_client_library.its_test(name, test, address, LONGEST / 5)
