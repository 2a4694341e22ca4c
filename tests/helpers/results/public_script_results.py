"""docs/results/public_scripts.md: other people's scripts on the simulated arms."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

CELLS = ("sim_ur5e", "sim_panda")
_HEAD = """# Public scripts on the simulated arms

Written by `SURG_TEST_FULL=1 SURG_PUBLIC_CLIENTS=FOLDER ./surg test --tier oracle
tests/ros/control/test_public_scripts_oracle.py`: crtk_python_client and dvrk_python, unmodified;
the simulator's truth judges tip and pivot. No `wait()` ended at its time-out.
"""
_SCRIPTS = (
    *("crtk_move_cp_example", "crtk_servo_cp_example", "crtk_servo_jp_example"),
    *("crtk_servo_cv_example", "crtk_xyz", "crtk_simple_orientation_registration"),
    *("crtk_teleop_example", "dvrk_arm_test", "dvrk_psm_test", "dvrk_move_wait_test"),
    *("dvrk_system_test", "dvrk_console_test", "crtk_haptic_example", "crtk_rate_example"),
    *("dvrk_psm_effort_test", "dvrk_mtm_test", "dvrk_teleoperation"),
)
_PAGE = ResultsPage(
    "public_scripts.md", _HEAD, _SCRIPTS, keep=True, columns=("script", "waits", *CELLS)
)
_found: dict[str, dict[str, str]] = {}


def note(script: str, cell: str, waits: int, result: str) -> None:
    """Print what a script did; its row is kept once both robots have been tried.

    Args:
        script: Its name, without ``.py``.
        cell: Of `CELLS`.
        waits: Calls of ``wait()``.
        result: What was found.
    """
    print(f"{script}, {cell}: {waits} waits: {result}")
    found = _found.setdefault(script, {})
    found[cell] = result
    if len(found) == len(CELLS):
        first, second = (found[each] for each in CELLS)
        words, _, pivot = second.rpartition("; ")
        if first.rpartition("; ")[0] == words:
            second = pivot if words else "the same"
        _PAGE.note(script, waits, f"{first} | {second}")
