"""Whether a simulation can still be believed. No ROS.

MuJoCo goes on after numbers that are not finite: it writes a warning into its state, sets positions
back, and the next state looks healthy. What comes after is no physics.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray


def all_finite(values: NDArray[np.float64]) -> bool:
    """Whether every one of some numbers, (n,), is finite.

    One product tells: it is finite only if all of them are. Only where it is not, which numbers
    above 1e150 do as well, they are looked at one by one.
    """
    return math.isfinite(values.dot(values)) or bool(np.isfinite(values).all())


def trouble(data: mujoco.MjData) -> str:
    """Why a simulation is unstable.

    Args:
        data: Its state after a step.

    Returns:
        A sentence; empty while all is well.
    """
    numbers = data.warning.number
    if numbers.any():
        kind = int(np.flatnonzero(numbers)[0])
        text = mujoco.mju_warningText(kind, int(data.warning.lastinfo[kind])).rstrip()
        return f"the simulation is not to be trusted: MuJoCo: {text}"
    if not (all_finite(data.qpos) and all_finite(data.qvel)):
        return "the simulation is not to be trusted: a position or velocity is not finite"
    return ""
