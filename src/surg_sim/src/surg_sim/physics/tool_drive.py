"""The instrument drive: a jaw that follows ``tool/servo_jp`` with a rate limit.

The jaw angle is a state of the drive. Where the instrument's URDF has a joint named ``jaw`` (and
joints that mimic it), stiff position servos show the angle on these joints.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

import surg_core
from surg_core.contract import TICK
from surg_sim.physics.spec_parts import add_position_servo

JOINT = "jaw"
"""Name of the jaw joint in an instrument's URDF."""
STIFFNESS, ARMATURE = 5.0, 1e-3
"""[N m/rad], [kg m^2]; assumed: strong against a finger of a few grams, the drive's rotor."""


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


def add_tool_drive(spec: mujoco.MjSpec, arm: surg_core.Arm) -> None:
    """Put a position servo on every jaw joint of the arm's instrument."""
    for name, _, _ in jaw_joints(arm.instrument_urdf):
        add_position_servo(spec, f"{arm.name}_{name}", STIFFNESS, ARMATURE)


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
