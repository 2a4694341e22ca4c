"""Runs the numbered examples as a reader does: one command each, in a folder of one's own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from surg_cli.host import paths

EXAMPLES = paths.ROOT / "examples"
STEPS = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))
ROS_STEP = EXAMPLES / "09_policy.py"
"""Needs a ROS graph; the others run in one process."""


def play(step: Path, folder: Path, *words: str) -> str:
    """Run a step and return what it prints.

    Args:
        step: Of ``STEPS``.
        folder: Current directory of the step.
        *words: Its arguments.
    """
    done = subprocess.run(
        [sys.executable, str(step), *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, f"{step.name}: {done.stdout}{done.stderr}"
    return done.stdout
