"""Whether a simulation can still be believed. No ROS.

MuJoCo goes on after numbers that are not finite: it writes a warning into its state, sets positions
back, and the next state looks healthy. What comes after is no physics.
"""

from __future__ import annotations

import mujoco
import numpy as np


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
    if not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
        return "the simulation is not to be trusted: a position or velocity is not finite"
    return ""
