"""An environment with PyPI's `ur_rtde`, beside the checkout and never in git."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from surg_cli.host import paths

VERSION = "1.6.5"


def python() -> Path:
    """The interpreter of the environment; made when it is missing, else the test is skipped."""
    folder = paths.ROOT / f".venv-oracle-ur-rtde-{VERSION}"
    interpreter, stamp = folder / "bin" / "python", folder / ".complete"
    if stamp.exists():
        return interpreter
    pip = [str(interpreter), "-m", "pip", "--disable-pip-version-check", "install", "-q"]
    steps = [
        [str(paths.SYSTEM_PYTHON), "-m", "venv", str(folder)],
        [*pip, f"ur_rtde=={VERSION}"],
        [str(interpreter), "-c", "import rtde_control, rtde_receive, dashboard_client"],
    ]
    for step in steps:
        done = subprocess.run(step, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            last = done.stderr.strip().splitlines()[-1:]
            pytest.skip(f"missing: an environment with ur_rtde {VERSION}: {last}")
    stamp.touch()
    return interpreter
