"""Environments with other people's clients of robot arms, beside the checkout and never in git."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from helpers.tree import oracle_venv

CLIENTS = Path(__file__).parent
MODULES = {
    "ur_rtde==1.6.5": ("rtde_control", "rtde_receive", "dashboard_client"),
    "urx==0.11.0": ("urx",),
    "franky-sim==1.0.4": ("franky_sim.mujoco_simulator",),
    "panda-python==1.1.1": ("panda_py",),
    "pylibfranka==0.21.3": ("pylibfranka",),
}
"""Requirement -> modules that must be there."""
BESIDE = {
    "franky-sim==1.0.4": ("mujoco==4.0.0", "pin==4.1.0", "numpy==2.4.6"),
    "urx==0.11.0": ("numpy==2.2.6", "math3d==4.0.0"),
    "panda-python==1.1.1": ("numpy==2.2.6", "requests==2.32.5", "websockets==15.0.1"),
    "pylibfranka==0.21.3": ("numpy==2.2.6",),
}
"""What a requirement leaves open."""


def python(requirement: str) -> Path:
    """The interpreter of a client's environment; made when it is missing, else the test is skipped.

    Args:
        requirement: One of `MODULES`.
    """
    words = (requirement, *BESIDE.get(requirement, ()))
    return oracle_venv.python(requirement.replace("==", "-"), [words], MODULES[requirement])


def call(requirement: str, address: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a client's program against an emulated arm, whose address goes in for `ADDRESS`."""
    return subprocess.run(
        [str(python(requirement)), *(word.replace("ADDRESS", address) for word in words)],
        capture_output=True,
        text=True,
        timeout=120,
        env={},
    )


def figures(requirement: str, address: str, client: str, *words: str) -> dict[str, Any]:
    """What one of the clients beside this file prints of an emulated arm."""
    done = call(requirement, address, str(CLIENTS / client), address, *words)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    print(json.dumps(found, indent=1))
    return found
