"""Detects an unstable simulation. No ROS.

MuJoCo continues after non-finite numbers: it records a warning and resets positions, and the next
state looks healthy. The results after that are not physical.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray


def all_finite(values: NDArray[np.float64]) -> bool:
    """Whether all values, (n,), are finite.

    A finite dot product proves it. Only if it is not finite, as also for values above 1e150, each
    value is checked.
    """
    return math.isfinite(values.dot(values)) or bool(np.isfinite(values).all())


def trouble(data: mujoco.MjData) -> str:
    """Why a simulation is unstable after a step, in one sentence; empty if it is stable."""
    numbers = data.warning.number
    if numbers.any():
        kind = int(np.flatnonzero(numbers)[0])
        text = mujoco.mju_warningText(kind, int(data.warning.lastinfo[kind])).rstrip()
        return f"the simulation is not to be trusted: MuJoCo: {text}"
    if not (all_finite(data.qpos) and all_finite(data.qvel)):
        return "the simulation is not to be trusted: a position or velocity is not finite"
    return ""
