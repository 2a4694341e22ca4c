"""docs/results/public_scripts.md: other people's scripts on the simulated arms."""

from __future__ import annotations

import os
from collections.abc import Sequence

from helpers.results.results_page import ResultsPage

CELLS = ("sim_ur5e", "sim_panda")
_HEAD = """# Public scripts on the simulated arms

Written by `SURG_TEST_FULL=1 SURG_PUBLIC_CLIENTS=FOLDER ./surg test --tier oracle
tests/ros/control/test_public_scripts_oracle.py`; the folder holds checkouts of crtk_python_client
and dvrk_python. The scripts run unmodified. The simulator's truth is the judge of tip and pivot.
In vain: calls of `wait()` that ended at their time-out. *No*: the reason is asserted as well.

| script, robot | waits | result |
|---|---|---|
"""
_SCRIPTS = (
    *("crtk_move_cp_example", "crtk_servo_cp_example", "crtk_servo_jp_example"),
    *("crtk_servo_cv_example", "crtk_xyz", "crtk_simple_orientation_registration"),
    *("crtk_teleop_example", "dvrk_arm_test", "dvrk_psm_test", "dvrk_move_wait_test"),
    *("dvrk_system_test", "dvrk_console_test", "crtk_haptic_example", "crtk_rate_example"),
    *("dvrk_psm_effort_test", "dvrk_mtm_test", "dvrk_teleoperation"),
)
_ROWS: Sequence[str] = [f"{script}, {cell}" for script in _SCRIPTS for cell in CELLS]
_PAGE = ResultsPage("public_scripts.md", _HEAD, _ROWS, keep=True)


def note(script: str, cell: str, waits: int, result: str) -> None:
    """Print and keep what a script did.

    Args:
        script: Its name, without ``.py``.
        cell: Of `CELLS`.
        waits: Calls of ``wait()``.
        result: What was found.
    """
    _PAGE.note(f"{script}, {cell}", waits, f"{result}; load {os.getloadavg()[0]:.0f}")
