"""A velocity-commanded industrial arm in MuJoCo: the simulated half of the robot-link contract.

The joint drive is an integrator position servo (stiffness kp, critically damped) behind a
first-order lag of its own and a command delay of whole ticks; the arm's weight is compensated. The
link converts a flange twist to joint velocities itself and has its own dead-man, counted in ticks.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

import surg_core
from surg_core.contract import TICK
from surg_sim.appearance.drawing import OUTSIDE
from surg_sim.arrays import Array
from surg_sim.physics.spec_parts import quaternion
from surg_sim.physics.stability import all_finite
from surg_sim.physics.tool_drive import jaw_joints, wrist_joints
from surg_sim.physics.urdf_reading import read_urdf

_URDF_VISUAL = 1  # group that MuJoCo gives to what a URDF calls visual

SUBSTEPS = 2
"""MuJoCo steps per tick."""


@dataclass(frozen=True)
class ActuatorParameters:
    """What a velocity-commanded arm does to its commands.

    Fixed before any deviation is looked at.
    """

    # Servo stiffness of a joint [N m/rad]; assumed: 2e4 deflects visibly under a surgeon's
    # accelerations, which industrial arms do not.
    stiffness: float = 1e5
    # Least natural frequency of a joint's servo at home [rad/s]: a heavy arm has stiffer drives.
    # Assumed: a little below that of the UR5e's and the Panda's slowest joint.
    bandwidth: float = 180.0
    # Share of the stiffness (and armature) that the last ``small_joints`` joints have; assumed from
    # the sizes of a six-axis arm's joints.
    small_share: float = 0.35
    small_joints: int = 3  # number of small joints at the wrist
    # Damping of the servo relative to critical at the home posture; assumed.
    damping_ratio: float = 1.0
    armature: float = 0.3  # reflected rotor inertia of a large joint [kg m^2]; assumed
    # Time constants of the joints' velocity servos [s]: least and greatest, drawn once for all
    # episodes; assumed, of the order reported for velocity interfaces of collaborative arms.
    lag: tuple[float, float] = (0.004, 0.012)
    # Ticks between receipt and execution of a command; assumed (one for the network, one for the
    # robot's own cycle).
    delay: int = 2
    # Ticks without a command after which the arm stops by itself (F10): 40 ms, as the links of real
    # arms. It goes straight on in joint space until then, and the shaft leaves its pivot.
    dead_man: int = 20
    # Pull of a redundant arm to its home posture behind a twist command [1/s].
    posture_gain: float = 1.0

    def stiffnesses(self, dof: int) -> Array:
        """Stiffness per joint [N m/rad], (dof,)."""
        return self.stiffness * self._sizes(dof)

    def armatures(self, dof: int) -> Array:
        """Armature per joint [kg m^2], (dof,)."""
        return self.armature * self._sizes(dof)

    def lags(self, dof: int) -> Array:
        """Time constant per joint [s], (dof,)."""
        return np.random.default_rng(0).uniform(*self.lag, dof)

    def _sizes(self, dof: int) -> Array:
        sizes = np.ones(dof)
        sizes[max(dof - self.small_joints, 0) :] = self.small_share
        return sizes


DRIVES = ActuatorParameters()
"""Of every simulated arm."""


@dataclass(frozen=True)
class ArmCommand:
    """What arrives at the links of one arm in one tick; ``None`` means nothing did."""

    velocity: Array | None = None  # (n,) joint velocities [rad/s], or None
    # (6,) flange twist v [m/s], omega [rad/s] in the base frame at the flange origin, or None. At
    # most one of velocity and twist is given.
    twist: Array | None = None
    jaw: float | None = None  # jaw angle [rad], or None
    wrist: Array | None = None  # (n,) of the wrist's drive [rad], or None


@dataclass(frozen=True)
class ToolError:
    """How the true instrument differs from its URDF, and so from a calibration that equals it.

    The controller believes its calibration; the simulator mounts the instrument a little wrong.
    The directions are drawn by the seed.
    """

    tip: float  # displacement of the tip across the shaft [m]
    axis: float  # turn of the shaft about the tip [rad]
    seed: int = 0  # of the two directions

    def mount(self, X_FTip: Array) -> Array:
        """The motion D (4, 4) in the flange frame with X_FTrueTip = D X_FTip.

        X_FTip (4, 4) is the believed pose of the tip, z along the shaft.
        """
        towards, about = np.random.default_rng(self.seed).uniform(0.0, 2.0 * np.pi, 2)
        R, p = X_FTip[:3, :3], X_FTip[:3, 3]
        w = R @ (np.array([np.cos(about), np.sin(about), 0.0]))
        K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        D = np.eye(4)
        D[:3, :3] += np.sin(self.axis) * K + (1.0 - np.cos(self.axis)) * (K @ K)
        shift = self.tip * (R @ np.array([np.cos(towards), np.sin(towards), 0.0]))
        D[:3, 3] = p + shift - D[:3, :3] @ p
        return D


def add_arm(spec: mujoco.MjSpec, arm: surg_core.Arm, error: ToolError | None = None) -> None:
    """Put a robot and its instrument, both from URDF, into the scene.

    Names in the scene are `robot_part`'s, and those of the instrument carry the prefix ``<arm>_``.
    The instrument's mount link lies in the robot's flange link, or as wrong as ``error`` says.
    """
    robot, instrument = arm.robot, arm.instrument
    X_WB, of_robot = arm.X_WB_stated, robot_part(arm, "")
    root = _hang(spec.worldbody, X_WB, arm.urdf_path, robot.base_link, robot.joint_names, of_robot)
    for geom in root.find_all(mujoco.mjtObj.mjOBJ_GEOM):  # the instrument's are seen inside, too
        geom.group = OUTSIDE if geom.group == _URDF_VISUAL else geom.group
    X_FMount = np.eye(4) if error is None else error.mount(tip_in_flange(arm))
    flange, of_tool = spec.body(robot_part(arm, robot.flange_link)), f"{arm.name}_"
    driven = [name for name, _, _ in jaw_joints(arm.instrument_urdf)] + [*wrist_joints(arm)]
    _hang(flange, X_FMount, arm.instrument_urdf, instrument.mount_link, driven, of_tool)
    for body in [root, *root.find_all(mujoco.mjtObj.mjOBJ_BODY)]:
        body.gravcomp = 1.0

    dof = len(robot.joint_names)
    stiffness, armature = DRIVES.stiffnesses(dof), DRIVES.armatures(dof)
    for i, name in enumerate(robot.joint_names):
        joint = spec.joint(robot_part(arm, name))
        joint.armature = armature[i]
        _add_servo(spec, joint.name, stiffness[i])


def robot_part(arm: surg_core.Arm, name: str) -> str:
    """Name in the scene of a link or joint of the arm's robot: no instrument has the same."""
    return f"{arm.name}_robot_{name}"


def _hang(
    parent: mujoco.MjsBody, X: Array, file: Path, link: str, driven: Collection[str], prefix: str
) -> mujoco.MjsBody:
    """Put a URDF into the scene with one of its links at X (4, 4) in the parent; returns its root.

    What lies above the link stands there, too, with its joints at 0: pedestal, cart, ceiling.
    Nothing of it collides: vendors' shapes overlap.
    """
    above = {joint.child: joint for joint in surg_core.load_urdf(file).joints}
    X_RootLink, root = np.eye(4), link
    while root in above:
        X_RootLink, root = above[root].X_PJ @ X_RootLink, above[root].parent
    X_ParentRoot = X @ np.linalg.inv(X_RootLink)
    part = mujoco.MjSpec.from_string(read_urdf(file, driven))
    for geom in part.geoms:
        geom.contype = geom.conaffinity = 0
    place = parent.add_frame(
        pos=X_ParentRoot[:3, 3].tolist(), quat=quaternion(X_ParentRoot[:3, :3]).tolist()
    )
    return place.attach_body(part.body(root), prefix, "")


def tip_in_flange(arm: surg_core.Arm) -> Array:
    """Pose of the tip in the flange frame by the instrument's URDF, (4, 4)."""
    mount, tip = arm.instrument.mount_link, arm.instrument.tip_link
    return np.asarray(surg_core.fixed_transform(arm.instrument_urdf, mount, tip))


def _add_servo(spec: mujoco.MjSpec, joint: str, stiffness: float) -> None:
    """Torque = kp (integral of u - q) + kd (u - qd), kd being set after compilation."""
    spring = spec.add_actuator(
        name=f"{joint}_servo",
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        dyntype=mujoco.mjtDyn.mjDYN_INTEGRATOR,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
    )
    spring.gainprm[0] = stiffness
    spring.biasprm[1] = -stiffness
    damper = spec.add_actuator(
        name=f"{joint}_damper",
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
    )
    damper.gainprm[0] = 1.0
    damper.biasprm[2] = -1.0


def evenly(indices: Sequence[int] | NDArray[np.int_]) -> slice | NDArray[np.int_]:
    """Indices as a slice where they are evenly apart, which numpy takes in half the time."""
    first, *others = map(int, indices)
    step = others[0] - first if others else 1
    last = first + step * len(others)
    if step > 0 and [first, *others] == list(range(first, last + 1, step)):
        return slice(first, last + 1, step)
    return np.array([first, *others])


class ArmLink:
    """One arm of a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: surg_core.Arm) -> None:
        self._model, self._data = model, data
        self.name: str = arm.name
        self._home = np.asarray(arm.robot.home, dtype=np.float64)
        self._velocity_limit = np.asarray(arm.robot.velocity, dtype=np.float64)
        self._acceleration_limit = np.asarray(arm.robot.acceleration, dtype=np.float64)
        self.dof = len(self._home)
        names = [robot_part(arm, name) for name in arm.robot.joint_names]
        joints = [model.joint(name) for name in names]
        self._qpos = evenly([j.qposadr[0] for j in joints])
        self._columns = np.array([j.dofadr[0] for j in joints])
        self._qvel = evenly(self._columns)
        springs = [model.actuator(f"{name}_servo") for name in names]
        dampers = [model.actuator(f"{name}_damper") for name in names]
        self._act = np.array([s.actadr[0] for s in springs])
        self._spring_ctrl = evenly([s.id for s in springs])
        self._damper_ctrl = evenly([d.id for d in dampers])
        self._flange = model.body(robot_part(arm, arm.robot.flange_link)).id
        self._R_BW = np.asarray(arm.X_WB_stated[:3, :3], dtype=np.float64).T
        self._filter = 1.0 - np.exp(-TICK / SUBSTEPS / DRIVES.lags(self.dof))
        self._jacobian = np.empty((2, 3, model.nv))
        self._standstill = ArmCommand(velocity=np.zeros(self.dof))
        self._tune()
        self.reset()

    def _tune(self) -> None:
        """Choose the least stiffness for the inertia at the home posture, and critical damping."""
        self._data.qpos[self._qpos] = self._home
        mujoco.mj_forward(self._model, self._data)
        mass = np.empty((self._model.nv, self._model.nv))
        mujoco.mj_fullM(self._model, self._data, mass)
        inertia = np.diag(mass)[self._qvel]
        least = DRIVES.bandwidth**2 * inertia
        stiffness = np.maximum(DRIVES.stiffnesses(self.dof), least)
        self._model.actuator_gainprm[self._spring_ctrl, 0] = stiffness
        self._model.actuator_biasprm[self._spring_ctrl, 1] = -stiffness
        damping = 2 * DRIVES.damping_ratio * np.sqrt(stiffness * inertia)
        self._model.actuator_gainprm[self._damper_ctrl, 0] = damping
        self._model.actuator_biasprm[self._damper_ctrl, 2] = -damping

    def reset(self) -> None:
        """Home posture at rest, nothing commanded."""
        self._data.qpos[self._qpos] = self._home
        self._data.qvel[self._qvel] = 0.0
        self._data.act[self._act] = self._home
        self._target = np.zeros(self.dof)
        self._filtered = np.zeros(self.dof)
        self._pending: deque[ArmCommand] = deque([self._standstill] * DRIVES.delay)
        self._latest = self._standstill
        self._silent = 0
        self._heard = False
        self.dead_man = False
        self.fault = ""
        self.condition = surg_core.RobotCondition.ACTIVE
        """Anything else, and the drives bring the arm to rest, whatever arrives."""
        self.speed_scaling = 1.0
        """Share of the commanded velocity that the drives follow."""

    @property
    def q(self) -> Array:
        """Joint positions [rad], (n,), a copy."""
        return np.array(self._data.qpos[self._qpos])

    @property
    def qd(self) -> Array:
        """Joint velocities [rad/s], (n,), a copy."""
        return np.array(self._data.qvel[self._qvel])

    def accept(self, command: ArmCommand | None) -> None:
        """Take what arrived in this tick and decide what the drives shall follow.

        A command that is not finite or has the wrong length counts as no command and is named in
        ``fault`` until a good one arrives.
        """
        usable = command is not None and self._usable(command)
        if usable:
            assert command is not None
            self._latest, self._silent, self._heard = command, 0, True
            self.dead_man, self.fault = False, ""
        else:
            self._silent += 1
            if self._heard and self._silent > DRIVES.dead_man:
                self.dead_man, self._latest = True, self._standstill
        if not self.obeys:  # nothing of before is executed later
            self._latest = self._standstill
            self._pending = deque([self._standstill] * DRIVES.delay)
        self._pending.append(self._latest)
        due = self._pending.popleft()
        if self.dead_man or not self.obeys:
            self._target = self._ramped(self._target)
        else:
            self._target = self.speed_scaling * self._joint_velocity(due)

    @property
    def obeys(self) -> bool:
        """Whether the drives follow commands, at full speed or slowed."""
        condition = surg_core.RobotCondition
        return self.condition in (condition.ACTIVE, condition.SLOWED)

    def _usable(self, command: ArmCommand) -> bool:
        values, n = (command.velocity, self.dof) if command.twist is None else (command.twist, 6)
        if values is None:
            return False
        if len(values) != n:
            self.fault = f"command has {len(values)} values, {n} are needed"
            return False
        if not all_finite(values):
            self.fault = "command is not finite"
            return False
        return True

    def _ramped(self, target: Array) -> Array:
        """One tick of a stop in which no joint exceeds its acceleration and the direction stays."""
        left = float(np.max(np.abs(target) / self._acceleration_limit))
        return target * max(0.0, 1.0 - TICK / left) if left > 0.0 else target

    def _joint_velocity(self, command: ArmCommand) -> Array:
        """Joint velocities of a command, uniformly scaled into the joints' velocity limits."""
        if command.twist is not None:
            qd = self._resolve(command.twist)
        else:
            assert command.velocity is not None
            qd = command.velocity
        excess = float((np.abs(qd) / self._velocity_limit).max())
        if excess > 1.0 + 1e-9:
            self.fault = f"joint velocity limit exceeded by a factor {excess:.2f}: scaled down"
            return np.asarray(qd / excess)
        return qd

    def _resolve(self, twist: Array) -> Array:
        """Joint velocities J^+ twist + (I - J^+ J) k (q_home - q), J^+ = J^T (J J^T)^-1."""
        linear, angular = self._jacobian
        origin = self._data.xpos[self._flange]
        mujoco.mj_jac(self._model, self._data, linear, angular, origin, self._flange)
        columns = self._columns
        J = np.vstack([self._R_BW @ linear[:, columns], self._R_BW @ angular[:, columns]])
        posture = np.zeros(self.dof)
        if self.dof > 6:
            posture = DRIVES.posture_gain * (self._home - self.q)
        try:
            return posture + J.T @ np.linalg.solve(J @ J.T, twist - J @ posture)
        except np.linalg.LinAlgError:
            self.fault = "the arm is singular: it cannot follow a flange twist here"
            return np.zeros(self.dof)

    def substep(self) -> None:
        """Before each MuJoCo step: advance the lag and hand the velocity to the drives."""
        self._filtered += self._filter * (self._target - self._filtered)
        self._data.ctrl[self._spring_ctrl] = self._filtered
        self._data.ctrl[self._damper_ctrl] = self._filtered
