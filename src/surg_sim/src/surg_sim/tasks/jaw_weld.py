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


class JawWeld:
    """The hold of one jawed tool on a light free body in a compiled scene; see ``add_jaw_weld``.

    Attributes:
        held: Whether the jaws hold it.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, arm: str, tip: str, target: str
    ) -> None:
        self._model, self._data = model, data
        self._tip, self._body = (int(model.body(name).id) for name in (f"{arm}_{tip}", target))
        self._jaw = int(model.joint(f"{arm}_jaw").qposadr[0])
        self._weld = int(model.equality(f"{arm}_holds_{target}").id)
        self._free = int(model.joint(target).qposadr[0])
        self.held = False

    def take(self, point: Array, at: Array, turn: Array) -> None:
        """Put the body into the jaws; the arms' kinematics are up to date. See ``pose``."""
        data = self._data
        self.pose(point, at, turn)
        self.held = True
        data.eq_active[self._weld] = 1
        R_WT, R_WBody = data.xmat[self._tip].reshape(3, 3), np.empty(9)
        quat = times(data.xquat[self._tip], turn)
        mujoco.mju_quat2Mat(R_WBody, quat)
        grip = data.xpos[self._tip] + R_WT @ at
        data.qpos[self._free : self._free + 3] = grip - R_WBody.reshape(3, 3) @ point
        data.qpos[self._free + 3 : self._free + 7] = quat

    def pose(self, point: Array, at: Array, turn: Array) -> None:
        """State where the jaws hold the body.

        Args:
            point: Of the body (3,) [m].
            at: Its place in the tip's frame (3,) [m].
            turn: Of the body in that frame, as a quaternion.
        """
        torque_scale = 1.0
        self._model.eq_data[self._weld, :11] = [*point, *at, *turn, torque_scale]

    def let_go(self) -> None:
        """From now on the body is free."""
        self.held = False
        self._data.eq_active[self._weld] = 0

    @property
    def open(self) -> bool:
        """Whether the jaws are too far open to hold anything."""
        return float(self._data.qpos[self._jaw]) > OPEN


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
