"""The weld by which jaws hold a needle or a thread, and the turns that its rest pose is made of."""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.arrays import Array

OPEN = 0.15
"""Jaw angle above which the jaws let go [rad]; assumed."""


def add_jaw_weld(spec: mujoco.MjSpec, arm: str, tip: str, target: str) -> None:
    """Weld ``<arm>_holds_<target>`` of a light body to the arm's tip; switches contacts on."""
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.add_equality(
        name=f"{arm}_holds_{target}",
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=f"{arm}_{tip}",
        name2=target,
        active=True,
        solref=[0.004, 1.0],
        solimp=[0.98, 0.98, 0.001, 0.5, 2.0],
    )


def rotation(vector: Array) -> Array:
    """Quaternion w, x, y, z of a rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(vector))
    quat = np.empty(4)
    mujoco.mju_axisAngle2Quat(quat, vector / angle if angle > 0.0 else np.eye(3)[2], angle)
    return quat


def times(a: Array, b: Array) -> Array:
    """Product of two quaternions."""
    out = np.empty(4)
    mujoco.mju_mulQuat(out, a, b)
    return out


def between(a: Array, b: Array) -> Array:
    """Rotation vector (3,) from quaternion b to a, in the outer frame [rad]."""
    back, vector = np.empty(4), np.empty(3)
    mujoco.mju_negQuat(back, b)
    mujoco.mju_quat2Vel(vector, times(a, back), 1.0)
    return vector
