"""The drive of a wrist: two servos that follow ``tool/servo_jp`` behind a lag.

Each is of second order and critically damped, as a position servo behind cables. Its command goes
to a stiff joint in the scene, which loads push back a little.
"""

from __future__ import annotations

import mujoco
import numpy as np

import surg_core
from surg_core.contract import TICK
from surg_sim.arrays import Array
from surg_sim.physics.spec_parts import add_position_servo

JOINTS = ("wrist_pitch", "wrist_yaw")
"""Names of a wrist's joints in an instrument's URDF."""
_STIFFNESS, _ARMATURE = 20.0, 1e-4  # [N m/rad], [kg m^2]; assumed: cables of a small instrument
_JOINT_LAG = 2.0 * (_ARMATURE / _STIFFNESS) ** 0.5  # [s] of the joint behind the servo
_STEPS = 8  # of the servo's own integration in a tick
_LEAST_LAG = 0.004  # [s] of a servo that has hardly any


def wrist_joints(arm: surg_core.Arm) -> tuple[str, ...]:
    """Names of the wrist's joints; none for a straight instrument."""
    return () if arm.instrument.wrist is None else JOINTS


def add_wrist_drive(spec: mujoco.MjSpec, arm: surg_core.Arm) -> None:
    """Put a position servo on each joint of the arm's wrist."""
    for name in wrist_joints(arm):
        add_position_servo(spec, f"{arm.name}_{name}", _STIFFNESS, _ARMATURE)


class WristDrive:
    """The wrist of one arm in a compiled scene; joints are pitch and yaw."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        arm: surg_core.Arm,
        wrist: surg_core.WristConfig,
    ) -> None:
        self._data = data
        self._range = np.asarray(wrist.min), np.asarray(wrist.max)
        servo_lag = max(float(wrist.drive_lag) - _JOINT_LAG, _LEAST_LAG)
        self._bandwidth = 2.0 / servo_lag  # [rad/s]
        names = [f"{arm.name}_{name}" for name in JOINTS]
        self._qpos = np.array([int(model.joint(name).qposadr[0]) for name in names])
        self._qvel = np.array([int(model.joint(name).dofadr[0]) for name in names])
        self._ctrl = np.array([int(model.actuator(f"{name}_servo").id) for name in names])
        self.reset()

    def reset(self) -> None:
        """Straight and at rest."""
        self._goal = np.zeros(2)
        self._servo, self._rate = np.zeros(2), np.zeros(2)
        self._data.qpos[self._qpos] = self._data.ctrl[self._ctrl] = 0.0

    @property
    def angles(self) -> Array:
        """Measured (2,) [rad]."""
        return np.array(self._data.qpos[self._qpos])

    @property
    def rates(self) -> Array:
        """Measured (2,) [rad/s]."""
        return np.array(self._data.qvel[self._qvel])

    def accept(self, joints: Array | None) -> None:
        """Take this tick's command (2,) [rad], None: none; one that is not finite is ignored."""
        if joints is not None and np.all(np.isfinite(joints)):
            self._goal = np.clip(joints, *self._range)
        w, step = self._bandwidth, TICK / _STEPS
        for _ in range(_STEPS):
            self._rate += step * (w * w * (self._goal - self._servo) - 2.0 * w * self._rate)
            self._servo += step * self._rate
        self._data.ctrl[self._ctrl] = self._servo
