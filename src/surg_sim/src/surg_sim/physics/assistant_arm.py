"""The assistant's instrument: a second grasper that turns about its own trocar, moved by a person.

It follows what is commanded with limited velocity and acceleration, as a hand does.
``assistant_scene`` puts it into the scene.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from surg_core.contract import TICK, VIRTUAL_JOINTS
from surg_core.transforms import make_pose
from surg_sim.arrays import Array
from surg_sim.physics.assistant_scene import JAWS, NAME, TIP

LOWER = np.array([-1.2, -1.2, 0.02, -2 * np.pi])
UPPER = np.array([1.2, 1.2, 0.24, 2 * np.pi])
"""Range of the virtual joints."""
VELOCITY = np.array([1.0, 1.0, 0.15, 3.0])
"""Fastest motion of a servo [rad/s, m/s]; assumed: a brisk hand."""
ACCELERATION = np.array([5.0, 5.0, 1.0, 15.0])
"""[rad/s^2, m/s^2]; assumed."""
DEPTH = 0.090
"""Insertion at home [m]."""
JAW_VELOCITY = 3.0
"""[rad/s]; as the robot's grasper; assumed."""


@dataclass(frozen=True)
class AssistantCommand:
    """What the assistant is told in one tick; ``None`` means nothing was said."""

    # (4,) virtual joints to go to: yaw, pitch [rad], insertion [m], roll [rad]; or None.
    joints: Array | None = None
    jaw: float | None = None  # jaw angle [rad], or None


def twist(yaw: float, pitch: float) -> float:
    """Angle about the shaft from turning by yaw, then pitch, to the smallest rotation [rad].

    As quaternions, turning by yaw then pitch is (cos y cos p, -cos y sin p, sin y cos p,
    sin y sin p) with half the angles; its part about z is what the smallest rotation leaves out.
    """
    y, p = yaw / 2.0, pitch / 2.0
    return -2.0 * math.atan2(math.sin(y) * math.sin(p), math.cos(y) * math.cos(p))


def towards(place: float, speed: float, goal: float, fastest: float, hardest: float) -> float:
    """Speed in the coming tick of a motion to a goal with limited speed and acceleration.

    Not faster than so that n more steps, each slower by no more than the limit, end at the goal:
    left = n v T - a T^2 n (n - 1) / 2.
    """
    left, change = goal - place, hardest * TICK
    n = max(math.ceil((math.sqrt(1.0 + 8.0 * abs(left) / (change * TICK)) - 1.0) / 2.0), 1)
    brake = abs(left) / (n * TICK) + change * (n - 1) / 2.0
    wanted = math.copysign(min(brake, fastest), left)
    return speed + min(max(wanted - speed, -change), change)


class Assistant:
    """The assistant's instrument in a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._data = data
        self._qpos, self._ctrl = _addresses(model, VIRTUAL_JOINTS)
        self._jaw_qpos, self._jaw_ctrl = _addresses(model, JAWS)
        self._tip = int(model.body(f"{NAME}_{TIP}").id)
        pivot = model.body(f"{NAME}_pivot")
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, pivot.quat)
        self.X_WRcm: Array = make_pose(pivot.pos, R.reshape(3, 3))
        """Pose of its trocar frame in the world, (4, 4)."""
        closed, opened = model.joint(f"{NAME}_{JAWS[0]}").range
        self._jaw_range = float(closed), float(opened)
        self.home = np.array([0.0, 0.0, DEPTH, 0.0])
        """Virtual joints at the start, (4,)."""
        self.reset()

    def reset(self) -> None:
        """At home, at rest, jaws closed."""
        self.target = self.home.copy()
        """Where the servos are told to be now, (4,): the command with limited rates."""
        self._goal = self.home.copy()
        self._velocity = np.zeros(4)
        self.jaw_target = self._jaw_goal = self._jaw_range[0]
        self.fault = ""
        """What was wrong with the last command that was refused; empty: nothing."""
        self._resting = False
        self._data.qpos[self._qpos] = self._servo_joints(self.home)
        self._data.qpos[self._jaw_qpos] = self.jaw_target
        self._drive()

    def pose(self, joints: Array) -> None:
        """Show the instrument at virtual joints (4,), without any motion."""
        self._data.qpos[self._qpos] = self._servo_joints(np.asarray(joints, dtype=np.float64))

    def accept(self, command: AssistantCommand | None) -> None:
        """Take this tick's command. What is not finite or of wrong length is refused (``fault``).

        Joints and jaw outside their range are clipped, as a stop would.
        """
        if command is None:
            return
        self._resting = False
        if command.joints is not None:
            joints = np.asarray(command.joints, dtype=np.float64)
            if joints.shape != (4,) or not np.isfinite(joints).all():
                self.fault = f"joints are {joints.tolist()}: four finite numbers are needed"
                return
            self._goal = np.clip(joints, LOWER, UPPER)
        if command.jaw is not None:
            if not np.isfinite(command.jaw):
                self.fault = f"jaw is {command.jaw}: a finite angle is needed"
                return
            self._jaw_goal = float(np.clip(command.jaw, *self._jaw_range))
        self.fault = ""

    def advance(self) -> None:
        """Move the servos' targets one tick on; called before the physics of that tick."""
        if self._resting:
            return
        before = self.target.tobytes(), self._velocity.tobytes(), self.jaw_target
        for i, place in enumerate(self.target.tolist()):
            speed, goal = float(self._velocity[i]), float(self._goal[i])
            speed = towards(place, speed, goal, float(VELOCITY[i]), float(ACCELERATION[i]))
            self._velocity[i] = speed
            self.target[i] = place + speed * TICK
        step_jaw = JAW_VELOCITY * TICK
        self.jaw_target += min(max(self._jaw_goal - self.jaw_target, -step_jaw), step_jaw)
        self._drive()
        # What one tick has not moved, the next one does not move either, until a command comes.
        after = self.target.tobytes(), self._velocity.tobytes(), self.jaw_target
        self._resting = before == after

    def _drive(self) -> None:
        self._data.ctrl[self._ctrl] = self._servo_joints(self.target)
        self._data.ctrl[self._jaw_ctrl] = self.jaw_target

    @staticmethod
    def _servo_joints(virtual: Array) -> Array:
        """Joints of the gimbal for virtual joints: its last one is not the roll."""
        joints = np.array(virtual, dtype=np.float64)
        joints[3] += twist(joints[0], joints[1])
        return joints

    @property
    def joints(self) -> Array:
        """Virtual joints as they are: yaw, pitch [rad], insertion [m], roll [rad], (4,)."""
        joints = np.array(self._data.qpos[self._qpos])
        joints[3] -= twist(joints[0], joints[1])
        return joints

    @property
    def jaw(self) -> float:
        """Angle of a finger as it is [rad]."""
        return float(self._data.qpos[self._jaw_qpos[0]])

    @property
    def p_WTip(self) -> Array:
        """Tip in the world [m], (3,)."""
        return np.array(self._data.xpos[self._tip])


def _addresses(
    model: mujoco.MjModel, names: Sequence[str]
) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Of joints: their addresses in ``qpos``, and of their servos in ``ctrl``."""
    joints = [model.joint(f"{NAME}_{name}") for name in names]
    servos = [model.actuator(f"{NAME}_{name}_servo") for name in names]
    return np.array([int(j.qposadr[0]) for j in joints]), np.array([int(s.id) for s in servos])
