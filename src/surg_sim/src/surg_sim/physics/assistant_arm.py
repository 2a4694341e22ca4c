"""The assistant's instrument: a second grasper that turns about its own trocar, moved by a person.

There is no robot behind it: four servos move yaw, pitch, insertion and roll, the virtual joints of
docs/reference/conventions.md, about a pivot that stands still in the wall. They follow what is
commanded with
limited velocity and acceleration, as a hand does.
"""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from surg_core.contract import TICK
from surg_core.transforms import minimal_rotation, virtual_joints
from surg_sim.physics.sim_arm import quaternion

if TYPE_CHECKING:
    from surg_sim.physics.scene import Site

Array = NDArray[np.float64]

NAME = "assistant"
"""Prefix of everything of the assistant in a scene, and its name on the wire."""
JOINTS = ("yaw", "pitch", "insertion", "roll")
"""Virtual joints in their order [rad, rad, m, rad]."""

LOWER = np.array([-1.2, -1.2, 0.02, -2 * np.pi])
UPPER = np.array([1.2, 1.2, 0.24, 2 * np.pi])
"""Range of the virtual joints."""
VELOCITY = np.array([1.0, 1.0, 0.15, 3.0])
"""Fastest motion of a servo [rad/s, m/s]; assumed: a brisk hand."""
ACCELERATION = np.array([5.0, 5.0, 1.0, 15.0])
"""[rad/s^2, m/s^2]; assumed."""
JAW_VELOCITY = 3.0
"""[rad/s]; as the robot's grasper; assumed."""

_SHAFT, _TIP = "shaft", "tip"
_JAWS = ("jaw", "jaw_mirror")
_STIFFNESS = np.array([400.0, 400.0, 2e4, 40.0])  # [N m/rad, N/m] strong beside a few newton
_ARMATURE = np.array([0.02, 0.02, 0.5, 0.002])  # [kg m^2, kg] assumed: hand and handle
_JAW_STIFFNESS, _JAW_ARMATURE = 5.0, 1e-3  # as ``jaw``


@dataclass(frozen=True)
class AssistantCommand:
    """What the assistant is told in one tick; ``None`` means nothing was said.

    Attributes:
        joints: (4,) virtual joints to go to: yaw, pitch [rad], insertion [m], roll [rad]; or None.
        jaw: Jaw angle [rad], or None.
    """

    joints: Array | None = None
    jaw: float | None = None


@dataclass(frozen=True)
class AssistantPort:
    """Where the assistant's trocar is, in patient axes about the work point.

    Attributes:
        trocar: The pivot [m], (3,).
        aim: A point on the shaft's axis at home, inside the patient [m], (3,).
        depth: Insertion at home [m].
    """

    trocar: tuple[float, float, float]
    aim: tuple[float, float, float] = (0.0, 0.015, -0.030)
    depth: float = 0.090

    @classmethod
    def opposite(cls, site: Site) -> AssistantPort:
        """On the other side of the patient's middle than the first arm's trocar, in the wall."""
        from surg_sim.physics.scene import wall_height

        x, y, _ = site.local(site.trocar)
        side = -1.0 if x > -0.02 else 1.0
        place = (float(side * max(abs(x), 0.075)), float(y))
        return cls(trocar=(*place, wall_height(site, *place)))


def swing(yaw: float, pitch: float) -> Array:
    """Smallest rotation from z to the shaft axis of these virtual joints, (3, 3)."""
    s = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    return minimal_rotation([0.0, 0.0, 1.0], s)


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


def forward(joints: Array) -> Array:
    """Pose of the tip in the trocar frame for virtual joints (4,), as (4, 4)."""
    yaw, pitch, insertion, roll = (float(v) for v in joints)
    c, s = np.cos(roll), np.sin(roll)
    X = np.eye(4)
    X[:3, :3] = swing(yaw, pitch) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    X[:3, 3] = insertion * X[:3, 2]
    return X


def add_assistant(
    spec: mujoco.MjSpec,
    site: Site,
    instrument: Path,
    port: AssistantPort | None = None,
    looks: bool = False,
) -> None:
    """Put the instrument, its pivot and its servos into the scene.

    Args:
        spec: The scene.
        site: The patient.
        instrument: URDF of a grasper: shaft and jaws are taken, the robot's holder is not.
        port: Where its trocar is; None: opposite the first arm's.
        looks: Also draw the cannula in the wall.
    """
    port = port or AssistantPort.opposite(site)
    X = port_frame(site, port)
    pivot = spec.worldbody.add_body(
        name=f"{NAME}_pivot", pos=X[:3, 3].tolist(), quat=quaternion(X[:3, :3]).tolist()
    )
    body = pivot
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for i, (name, kind, axis) in enumerate(
        zip(JOINTS, (hinge, hinge, slide, hinge),
            ([0, 1, 0], [-1, 0, 0], [0, 0, 1], [0, 0, 1]), strict=True)
    ):  # fmt: skip
        body = body.add_body(name=f"{NAME}_{name}")
        body.mass, body.inertia, body.explicitinertial = 0.02, [1e-5] * 3, True
        body.add_joint(name=f"{NAME}_{name}", type=kind, axis=axis, armature=_ARMATURE[i])
        _add_servo(spec, f"{NAME}_{name}", _STIFFNESS[i], _ARMATURE[i])

    grasper = mujoco.MjSpec.from_string(instrument.read_text("utf-8"))
    shaft = grasper.body(_SHAFT)  # parallel to the mount, as is its tip: no rotation to undo
    to_tip = np.array(grasper.body(_TIP).pos)
    offset = -(np.asarray(shaft.pos) + to_tip)
    body.add_frame(pos=offset.tolist()).attach_body(shaft, f"{NAME}_", "")
    for name in _JAWS:
        spec.joint(f"{NAME}_{name}").armature = _JAW_ARMATURE
        _add_servo(spec, f"{NAME}_{name}", _JAW_STIFFNESS, _JAW_ARMATURE)
    for part in [pivot, *pivot.find_all(mujoco.mjtObj.mjOBJ_BODY)]:
        part.gravcomp = 1.0
    if looks:
        from surg_sim.physics.scene import draw_cannula

        draw_cannula(spec.body(f"{NAME}_pitch"), np.array([0.0, 0.0, 1.0]))  # turns with the shaft
        _draw_handle(body, -float(to_tip[2]))


def _draw_handle(body: mujoco.MjsBody, end: float) -> None:
    """The handle that the assistant's hand would hold, where the shaft ends: only seen.

    Args:
        body: Carries the shaft; the tip is its origin, z the shaft's axis.
        end: The shaft's outer end on z [m].
    """
    from surg_sim.physics.scene import OUTSIDE

    def rod(start: Array, stop: Array, radius: float, material: str, kind: str) -> None:
        body.add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"),
            fromto=[*start, *stop],
            size=[radius, 0.0, 0.0],
            material=material,
            group=OUTSIDE,
            contype=0,
            conaffinity=0,
            mass=0.0,
        )

    axis, side = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    back = end * axis
    rod(back + 0.012 * axis, back - 0.012 * axis, 0.011, "seal", "CYLINDER")  # turns the shaft
    rod(back - 0.012 * axis, back - 0.050 * axis, 0.007, "scope", "CYLINDER")
    around = np.linspace(0.0, 2.0 * np.pi, 13)
    for lean, ring in ((-0.15, 0.012), (-0.75, 0.014)):  # for the fingers, for the thumb
        away = np.cos(lean) * side + np.sin(lean) * axis
        root = back - 0.044 * axis
        centre = root + (0.075 + ring) * away
        rod(root, root + 0.075 * away, 0.0042, "scope", "CAPSULE")
        across = np.cross([1.0, 0.0, 0.0], away)
        loop = centre + ring * (
            np.cos(around)[:, None] * away + 1.5 * np.sin(around)[:, None] * across
        )
        for start, stop in itertools.pairwise(loop):
            rod(start, stop, 0.0034, "scope", "CAPSULE")


def port_frame(site: Site, port: AssistantPort) -> Array:
    """Pose of the assistant's trocar frame in the world, (4, 4).

    Its z runs along the shaft at home; its x is the patient's x made perpendicular to it.
    """
    p_WRcm = site.place(port.trocar)
    z = site.place(port.aim) - p_WRcm
    z /= np.linalg.norm(z)
    x = site.R[:, 0] - (site.R[:, 0] @ z) * z
    x /= np.linalg.norm(x)
    X = np.eye(4)
    X[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    X[:3, 3] = p_WRcm
    return X


def _add_servo(spec: mujoco.MjSpec, joint: str, stiffness: float, inertia: float) -> None:
    servo = spec.add_actuator(
        name=f"{joint}_servo",
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
    )
    servo.gainprm[0] = stiffness
    servo.biasprm[1:3] = [-stiffness, -2.0 * np.sqrt(stiffness * inertia)]


class Assistant:
    """The assistant's instrument in a compiled scene.

    Args:
        model: The compiled scene.
        data: Its state.
        instrument: The URDF that ``add_assistant`` was given.
        depth: Insertion at home [m].
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        instrument: Path,
        depth: float = AssistantPort.depth,
    ) -> None:
        self._data = data
        self._qpos = np.array([int(model.joint(f"{NAME}_{n}").qposadr[0]) for n in JOINTS])
        self._ctrl = np.array([int(model.actuator(f"{NAME}_{n}_servo").id) for n in JOINTS])
        self._jaw_qpos = np.array([int(model.joint(f"{NAME}_{n}").qposadr[0]) for n in _JAWS])
        self._jaw_ctrl = np.array([int(model.actuator(f"{NAME}_{n}_servo").id) for n in _JAWS])
        self._tip = int(model.body(f"{NAME}_{_TIP}").id)
        pivot = model.body(f"{NAME}_pivot")
        self.X_WRcm: Array = np.eye(4)
        """Pose of its trocar frame in the world, (4, 4)."""
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, pivot.quat)
        self.X_WRcm[:3, :3], self.X_WRcm[:3, 3] = R.reshape(3, 3), pivot.pos
        self._jaw_range = _jaw_range(instrument)
        self.home = np.array([0.0, 0.0, depth, 0.0])
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

    def joints_for(self, p_WTip: Array, roll: float = 0.0) -> Array:
        """Virtual joints that bring the tip to a point in the world [m], with this roll."""
        X = self.X_WRcm
        return virtual_joints(X[:3, :3].T @ (np.asarray(p_WTip) - X[:3, 3]), roll)


def _jaw_range(instrument: Path) -> tuple[float, float]:
    """Limits of the jaw joint in the URDF [rad]."""
    root = ElementTree.parse(instrument).getroot()
    limit = root.find("joint[@name='jaw']/limit")
    if limit is None:
        raise ValueError(
            f"{instrument}: no joint 'jaw' with a limit: the assistant needs a grasper"
        )
    return float(limit.get("lower", "0")), float(limit.get("upper", "0"))
