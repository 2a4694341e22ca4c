"""Where two robots stand: a search over base placements, written out as a cell.

The instrument's shaft and the scope's shaft are put where a surgeon would want them in the patient;
then every base beside the table that can hold its shaft there is tried, and the one with the
largest reserve is taken. ::

    python3 -m surg_sim.placement OUT --instrument-robot ROBOT.yaml --endoscope-robot ROBOT.yaml

Reserve of an arm: the worst over the corners of a box round the home tip, at three rolls, of what
is left of each joint's range, speed and acceleration. Refused are placements in which a robot comes
too near to the other arm, to the table or to the patient.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from surg_sim.arm import ActuatorParameters, add_arm
from surg_sim.trocar import shaft_in_flange

if TYPE_CHECKING:
    import surg_core

Array = NDArray[np.float64]

VIEW = 0.100
"""Distance from the scope's lenses to the work point at home [m]."""
CLEARANCE = 0.04
"""Smallest distance between the arms, and of an arm to table and patient [m]."""
BEDSIDE = 0.42
"""Smallest distance of a base from the patient's long axis [m]: half a table and a pedestal."""


@dataclass(frozen=True)
class Task:
    """What an arm must be able to do round its home.

    Attributes:
        depth: Of the tip behind the trocar at home [m].
        box: (3,) half sides of the tip's box across and along the shaft [m].
        roll: Largest roll to either side [rad].
        speed: Of the tip, at which the joints' speed is judged [m/s].
        roll_speed: About the shaft, added to it [rad/s].
        acceleration: Of the tip [m/s^2].
    """

    depth: float
    box: tuple[float, float, float]
    roll: float
    speed: float
    roll_speed: float
    acceleration: float


INSTRUMENT = Task(0.120, (0.035, 0.035, 0.030), 1.0, 0.12, 1.0, 2.0)
"""The bundled motions."""
ENDOSCOPE = Task(0.060, (0.015, 0.015, 0.020), 0.6, 0.03, 0.3, 0.3)
"""Aims at any point of the instrument's box: +-18 degrees about each axis."""

_PATIENT = np.array([0.18, 0.27, 0.19])  # [m] half axes of the dome that no link may touch


@dataclass(frozen=True)
class Reserve:
    """The worst of an arm over its box.

    Attributes:
        margin: Smallest distance of a joint from its limit [rad].
        speed: Largest share of a joint's velocity limit.
        acceleration: Largest share of a joint's acceleration limit at the tip's own.
        singular: Smallest singular value of the flange Jacobian.
        postures: (m, n) the joint positions of the corners [rad].
    """

    margin: float
    speed: float
    acceleration: float
    singular: float
    postures: Array

    @property
    def score(self) -> float:
        """Larger is better: one number that no single weakness can hide in."""
        return min(
            1.0 - self.speed, 1.0 - self.acceleration / 1.6, self.margin, 2.5 * self.singular
        )


def inverse(chain: surg_core.Chain, start: Array, X: Array, steps: int = 60) -> Array | None:
    """Joints (n,) that put the flange at X (4, 4), by Newton steps from a start; None: no way."""
    q = start.copy()
    for _ in range(steps):
        present = np.asarray(chain.forward(q))
        turn = X[:3, :3] @ present[:3, :3].T
        w = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        if np.trace(turn) < 1.0:  # beyond 90 degrees the sine falls again
            w /= max(float(np.linalg.norm(w)), 1e-9)
        error = np.concatenate([X[:3, 3] - present[:3, 3], w])
        if np.abs(error).max() < 1e-10:
            return q
        J = np.asarray(chain.jacobian(q))
        step = J.T @ np.linalg.solve(J @ J.T + 1e-9 * np.eye(6), error)
        q = q + step * min(1.0, 0.4 / float(np.abs(step).max()))
    return None


def reserve(arm: surg_core.Arm, q_home: Array, task: Task) -> Reserve | None:
    """What an arm has left round a home posture; None: a corner is out of reach.

    Args:
        arm: The arm; its tool and limits count, its trocar does not.
        q_home: (n,) home posture [rad].
        task: What it shall do.
    """
    depth = task.depth
    p_FTip, s_F = shaft_in_flange(arm)
    robot, X_home = arm.robot, np.asarray(arm.chain.forward(q_home))
    R_home, s = X_home[:3, :3], X_home[:3, :3] @ s_F
    p_Rcm = R_home @ p_FTip + X_home[:3, 3] - depth * s
    low, high = np.asarray(robot.position_min), np.asarray(robot.position_max)
    x = np.cross(s, [0.0, 1.0, 0.0])
    R_BR = np.column_stack([x / np.linalg.norm(x), np.cross(s, x / np.linalg.norm(x)), s])
    found, margin, singular, speed, acceleration = [], np.inf, np.inf, 0.0, 0.0
    for signs in itertools.product((-1, 1), repeat=3):
        corner = R_BR @ (np.array([0.0, 0.0, depth]) + np.array(signs) * task.box)
        for roll in (-task.roll, 0.0, task.roll):
            q: Array | None = q_home
            for share in (0.5, 1.0):
                p = (1 - share) * depth * s + share * corner
                axis = p / np.linalg.norm(p)
                R = _between(s, axis) @ _turn(s, share * roll) @ R_home
                X = np.eye(4)
                X[:3, :3], X[:3, 3] = R, p_Rcm + p - R @ p_FTip
                q = inverse(arm.chain, q, X, 20)
                if q is None:
                    return None
            found.append(q)
            J = np.asarray(arm.chain.jacobian(q))
            singular = min(singular, float(np.linalg.svd(J, compute_uv=False)[5]))
            margin = min(margin, float(np.minimum(q - low, high - q).min()))
            # Flange twists of unit tip velocities and of unit roll about the shaft.
            L, r = float(np.linalg.norm(p)), X[:3, 3] - p_Rcm
            W = np.array([np.cross(axis, e) / L for e in np.eye(3)])
            V = np.array([(axis @ e) * axis for e in np.eye(3)]) + np.cross(W, r)
            back = np.linalg.pinv(J)
            rows = np.linalg.norm(back @ np.vstack((V.T, W.T)), axis=1)
            rolls = np.abs(back @ np.concatenate((np.cross(axis, r), axis)))
            share_v = (task.speed * rows + task.roll_speed * rolls) / np.asarray(robot.velocity)
            speed = max(speed, float(share_v.max()))
            share_a = task.acceleration * rows / np.asarray(robot.acceleration)
            acceleration = max(acceleration, float(share_a.max()))
    return Reserve(margin, speed, acceleration, singular, np.array(found))


def _turn(axis: Array, angle: float) -> Array:
    import surg_core

    return np.asarray(surg_core.axis_angle_to_matrix(np.asarray(axis, dtype=float), angle))


def _between(a: Array, b: Array) -> Array:
    """The smallest rotation (3, 3) that carries unit vector a to b."""
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    return np.eye(3) if sine < 1e-12 else _turn(axis / sine, float(np.arctan2(sine, a @ b)))


def scope_pose(work: Array, outwards: Array) -> Array:
    """Pose (4, 4) of the scope's tip that looks at the work point, its picture upright.

    Args:
        work: (3,) work point [m].
        outwards: (3,) unit vector from the work point to the lenses.
    """
    right = np.cross(-outwards, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    X = np.eye(4)
    X[:3, :3] = np.column_stack([right, np.cross(-outwards, right), -outwards])
    X[:3, 3] = work + VIEW * outwards
    return X


@dataclass(frozen=True)
class Stand:
    """One arm, put up.

    Attributes:
        base: (3,) its base from the work point, patient axes [m].
        yaw: Of its base [rad].
        q: (n,) home posture [rad].
        reserve: What it has left there.
    """

    base: Array
    yaw: float
    q: Array
    reserve: Reserve

    @property
    def X_PB(self) -> Array:
        """Base in the patient's frame at the work point, (4, 4)."""
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = _turn(np.array([0.0, 0.0, 1.0]), self.yaw), self.base
        return X


def stands(
    arm: surg_core.Arm,
    tips: Sequence[Array],
    bases: Sequence[Array],
    task: Task,
    rng: np.random.Generator,
    keep: int = 40,
) -> list[Stand]:
    """Every way to hold the tip there from one of these bases, the best first.

    Args:
        arm: The arm.
        tips: Wanted poses (4, 4) of the tip in the patient's frame; any of them will do.
        bases: (3,) places of the base; it faces the work point.
        task: What the arm shall be able to do.
        rng: Where the inverse kinematics start from.
        keep: How many of the least singular postures are looked at closely.
    """
    import surg_core

    X_FTip = np.asarray(
        surg_core.fixed_transform(
            arm.instrument_urdf, arm.instrument.mount_link, arm.instrument.tip_link
        )
    )
    low, high = np.asarray(arm.robot.position_min), np.asarray(arm.robot.position_max)
    home = np.asarray(arm.robot.home)
    found: list[tuple[float, Array, float, Array]] = []
    for base in bases:
        yaw = round(float(np.arctan2(-base[1], -base[0])), 3)
        X_PB = np.eye(4)
        X_PB[:3, :3], X_PB[:3, 3] = _turn(np.array([0.0, 0.0, 1.0]), yaw), base
        for tip in tips:
            X_BF = np.linalg.inv(X_PB) @ tip @ np.linalg.inv(X_FTip)
            for attempt in range(6):
                start = home + rng.normal(scale=1.0, size=len(home)) * (attempt > 0)
                q = inverse(arm.chain, start, X_BF)
                if q is None:
                    continue
                q = (q + np.pi) % (2 * np.pi) - np.pi
                if np.any(q < low + 0.3) or np.any(q > high - 0.3) or not _elbow_up(arm, q):
                    continue
                J = np.asarray(arm.chain.jacobian(q))
                found.append((float(np.linalg.svd(J, compute_uv=False)[5]), base, yaw, q))
    found.sort(key=lambda item: -item[0])
    best = [
        Stand(base, yaw, q, left)
        for _, base, yaw, q in found[:keep]
        if (left := reserve(arm, q, task)) is not None
    ]
    return sorted(best, key=lambda stand: -stand.reserve.score)


def _elbow_up(arm: surg_core.Arm, q: Array) -> bool:
    """Whether every joint from the second on stays above the base: no forearm in the drapes."""
    return all(_joint_origin(arm.chain, q, i)[2] > 0.05 for i in range(2, len(q)))


def _joint_origin(chain: surg_core.Chain, q: Array, i: int) -> Array:
    """The point of joint i's axis (3,) that is nearest to the flange, base frame [m]."""
    J, p = np.asarray(chain.jacobian(q)), np.asarray(chain.forward(q))[:3, 3]
    return np.asarray(p - np.cross(J[:3, i], J[3:, i]))  # v = w x (p - o)


class Neighbours:
    """The two arms in one MuJoCo scene, to measure how near they come to each other.

    Args:
        arms: Both arms; their bases are taken from the stands.
        stands: Where they stand.
        bed: Height of the table's top under the work point [m], negative.
    """

    def __init__(
        self, arms: Sequence[surg_core.Arm], stands: Sequence[Stand], bed: float = -0.136
    ) -> None:
        spec = mujoco.MjSpec()
        for arm, stand in zip(arms, stands, strict=True):
            add_arm(spec, replace(arm, X_WB=stand.X_PB), ActuatorParameters())
        still = spec.worldbody
        still.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.30, 0.62, 0.05],
                       pos=[0.0, 0.0, bed - 0.05])  # fmt: skip
        still.add_geom(name="patient", type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
                       size=_PATIENT.tolist(), pos=[0.0, 0.0, -0.056])  # fmt: skip
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._qpos, self._geoms, self._links = [], [], []
        for arm in arms:
            names = [f"{arm.name}_{name}" for name in arm.robot.joint_names]
            self._qpos.append([int(self.model.joint(name).qposadr[0]) for name in names])
            root = self.model.body_rootid[self.model.joint(names[0]).bodyid[0]]
            mount = self.model.body(f"{arm.name}_{arm.instrument.mount_link}").id
            owner = self.model.geom_bodyid
            mine = [g for g in range(self.model.ngeom) if self.model.body_rootid[owner[g]] == root]
            self._geoms.append(mine)
            self._links.append([g for g in mine if owner[g] <= mount])  # bodies are depth first
        self._still = [self.model.geom(name).id for name in ("table", "patient")]

    def clearance(self, first: Array, second: Array) -> float:
        """Smallest distance of a robot to the other arm, and to table and patient [m].

        The shafts in the patient may come as near to each other as the surgeon likes.
        """
        for where, q in zip(self._qpos, (first, second), strict=True):
            self.data.qpos[where] = q
        mujoco.mj_kinematics(self.model, self.data)
        (a, b), (links_a, links_b) = self._geoms, self._links
        pairs = [*itertools.product(links_a, b), *itertools.product(set(a) - set(links_a), links_b)]
        for links in self._links:
            pairs += list(itertools.product(links, self._still))
        return min(self._distance(a, b) for a, b in pairs)

    def _distance(self, a: int, b: int) -> float:
        far = 0.3
        centres = self.data.geom_xpos[a] - self.data.geom_xpos[b]
        reach = self.model.geom_rbound[a] + self.model.geom_rbound[b]
        if np.linalg.norm(centres) > reach + far:
            return far
        return float(mujoco.mj_geomDistance(self.model, self.data, a, b, far, None))
