"""Environments with other people's clients of UR arms, beside the checkout and never in git."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from surg_cli.host import paths

MODULES = {
    "ur_rtde==1.6.5": ("rtde_control", "rtde_receive", "dashboard_client"),
    "urx==0.11.0": ("urx",),
}
"""Requirement -> modules that must be there."""
BESIDE = {"urx==0.11.0": ("numpy==2.2.6", "math3d==4.0.0")}
"""What a requirement leaves open."""


def python(requirement: str) -> Path:
    """The interpreter of a client's environment; made when it is missing, else the test is skipped.

    Args:
        requirement: One of `MODULES`.
    """
    folder = paths.ROOT / f".venv-oracle-{requirement.replace('==', '-')}"
    interpreter, stamp = folder / "bin" / "python", folder / ".complete"
    if stamp.exists():
        return interpreter
    pip = [str(interpreter), "-m", "pip", "--disable-pip-version-check", "install", "-q"]
    steps = [
        [str(paths.SYSTEM_PYTHON), "-m", "venv", str(folder)],
        [*pip, requirement, *BESIDE.get(requirement, ())],
        [str(interpreter), "-c", f"import {', '.join(MODULES[requirement])}"],
    ]
    for step in steps:
        done = subprocess.run(step, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            last = done.stderr.strip().splitlines()[-1:]
            pytest.skip(f"missing: an environment with {requirement}: {last}")
    stamp.touch()
    return interpreter
