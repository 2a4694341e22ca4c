"""Environments with other people's clients of robot arms, beside the checkout and never in git."""

from __future__ import annotations

from pathlib import Path

from helpers.tree import oracle_venv

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
