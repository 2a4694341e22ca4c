"""The instrument drive: a jaw that follows ``tool/servo_jp`` with a rate limit, and a wrist.

The jaw angle is a state of the drive. Where the instrument's URDF has a joint named ``jaw`` (and
joints that mimic it), stiff position servos show the angle on these joints.

The servos of a wrist lag: each is of second order and critically damped, as behind cables. It moves
a stiff joint in the scene, which loads push back a little.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

import surg_core
from surg_core.contract import TICK
from surg_sim.arrays import Array
from surg_sim.physics.spec_parts import add_position_servo

JOINT = "jaw"
"""Name of the jaw joint in an instrument's URDF."""
STIFFNESS, ARMATURE = 5.0, 1e-3
"""[N m/rad], [kg m^2]; assumed: strong against a finger of a few grams, the drive's rotor."""


WRIST_JOINTS = ("wrist_pitch", "wrist_yaw", "wrist_roll")
"""Names of a wrist's joints in an instrument's URDF; the last where the drive turns the shaft."""
_WRIST_STIFFNESS, _WRIST_ARMATURE = (
    20.0,
    1e-4,
)  # [N m/rad], [kg m^2]; assumed: cables of a small instrument
_JOINT_LAG = 2.0 * (_WRIST_ARMATURE / _WRIST_STIFFNESS) ** 0.5  # [s] of the joint behind the servo
_STEPS = 8  # of the servo's own integration in a tick
_LEAST_LAG = 0.004  # [s] of a servo that has hardly any


def jaw_joints(urdf_path: Path) -> list[tuple[str, float, float]]:
    """The joints that show the jaw: (name, multiplier, offset [rad]), the jaw itself first.

    Empty when the URDF has no joint named ``jaw``.
    """
    joints = surg_core.load_urdf(urdf_path).joints
    shown = [(JOINT, 1.0, 0.0) for joint in joints if joint.name == JOINT]
    for joint in joints:
        mimic = joint.mimic
        if shown and mimic is not None and mimic.joint == JOINT:
            shown.append((joint.name, mimic.multiplier, mimic.offset))
    return shown


def wrist_joints(arm: surg_core.Arm) -> tuple[str, ...]:
    """Names of the wrist's joints; none for a straight instrument."""
    wrist = arm.instrument.wrist
    return () if wrist is None else WRIST_JOINTS[: 2 + wrist.rolls]


def add_tool_drive(spec: mujoco.MjSpec, arm: surg_core.Arm) -> None:
    """Put a position servo on every joint of the arm's jaw and wrist."""
    for name, _, _ in jaw_joints(arm.instrument_urdf):
        add_position_servo(spec, f"{arm.name}_{name}", STIFFNESS, ARMATURE)
    for name in wrist_joints(arm):
        add_position_servo(spec, f"{arm.name}_{name}", _WRIST_STIFFNESS, _WRIST_ARMATURE)


class ToolDrive:
    """The jaw of one arm in a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: surg_core.Arm) -> None:
        self._data = data
        self._min, self._max = float(arm.instrument.jaw_min), float(arm.instrument.jaw_max)
        self._step = float(arm.instrument.jaw_velocity) * TICK
        self._shown = [
            (
                int(model.actuator(f"{arm.name}_{name}_servo").id),
                int(model.joint(f"{arm.name}_{name}").qposadr[0]),
                multiplier,
                offset,
            )
            for name, multiplier, offset in jaw_joints(arm.instrument_urdf)
        ]
        self.reset()

    def reset(self) -> None:
        """Closed."""
        self.angle = self._goal = self._min
        self.velocity = 0.0
        for actuator, qpos, multiplier, offset in self._shown:
            self._data.qpos[qpos] = self._data.ctrl[actuator] = multiplier * self.angle + offset

    def accept(self, angle: float | None) -> None:
        """Take this tick's jaw command [rad] (None: none) and move by at most one rate step.

        A command that is not finite is ignored; one outside the jaw's range is clipped, as the
        drive's mechanical stop would.
        """
        if angle is not None and np.isfinite(angle):
            self._goal = min(max(angle, self._min), self._max)
        before = self.angle
        self.angle += min(max(self._goal - self.angle, -self._step), self._step)
        self.velocity = (self.angle - before) / TICK
        for actuator, _, multiplier, offset in self._shown:
            self._data.ctrl[actuator] = multiplier * self.angle + offset


class WristDrive:
    """The wrist of one arm in a compiled scene; its n joints are those of `wrist_joints`."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        arm: surg_core.Arm,
        wrist: surg_core.WristConfig,
    ) -> None:
        self._data = data
        servo_lag = max(float(wrist.drive_lag) - _JOINT_LAG, _LEAST_LAG)
        self._bandwidth = 2.0 / servo_lag  # [rad/s]
        names = [f"{arm.name}_{name}" for name in wrist_joints(arm)]
        self._n = len(names)
        self._range = np.asarray(wrist.min)[: self._n], np.asarray(wrist.max)[: self._n]
        self._qpos = np.array([int(model.joint(name).qposadr[0]) for name in names])
        self._qvel = np.array([int(model.joint(name).dofadr[0]) for name in names])
        self._ctrl = np.array([int(model.actuator(f"{name}_servo").id) for name in names])
        self.reset()

    def reset(self) -> None:
        """Straight and at rest."""
        self._goal, self._servo, self._rate = np.zeros((3, self._n))
        self._data.qpos[self._qpos] = self._data.ctrl[self._ctrl] = 0.0

    @property
    def angles(self) -> Array:
        """Measured (n,) [rad]."""
        return np.array(self._data.qpos[self._qpos])

    @property
    def rates(self) -> Array:
        """Measured (n,) [rad/s]."""
        return np.array(self._data.qvel[self._qvel])

    def accept(self, joints: Array | None) -> None:
        """Take this tick's command (n,) [rad], or (3,) of which the rest is not there.

        None: none; one that is not finite is ignored.
        """
        if joints is not None and np.all(np.isfinite(joints)):
            self._goal = np.clip(joints[: self._n], *self._range)
        w, step = self._bandwidth, TICK / _STEPS
        for _ in range(_STEPS):
            self._rate += step * (w * w * (self._goal - self._servo) - 2.0 * w * self._rate)
            self._servo += step * self._rate
        self._data.ctrl[self._ctrl] = self._servo
