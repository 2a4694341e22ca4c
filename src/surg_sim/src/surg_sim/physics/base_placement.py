"""Where two robots stand: a search over base placements, written out as a cell.

The instrument's shaft and the scope's shaft are put where a surgeon would want them in the patient;
then every base beside the table that can hold its shaft there is tried, and the one with the
largest reserve is taken. ::

    python3 -m surg_sim.physics.base_placement OUT --psm ROBOT.yaml GRASPER.yaml --ecm ROBOT.yaml
    SCOPE.yaml

Reserve of an arm: the worst over the corners of a box round the home tip, at three rolls, of what
is left of each joint's range, speed and acceleration. Refused are placements in which a robot comes
too near to the other arm, to the table or to the patient.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from surg_sim.physics.sim_arm import ActuatorParameters, add_arm
from surg_sim.physics.trocar import shaft_in_flange

if TYPE_CHECKING:
    import surg_core

Array = NDArray[np.float64]

VIEW = 0.100
"""Distance from the scope's lenses to the work point at home [m]."""
ELEVATION = np.radians(42.0)
"""Of the scope at home above the horizontal: flat enough for depth, steep enough to see the bed."""
CLEARANCE = 0.04
"""Smallest distance of a robot to the other arm, to table and patient, both at home [m]."""
CORNER_CLEARANCE = 0.02
"""The same with one arm in any corner of its box [m]."""
ANGLES = (np.radians(45.0), np.radians(90.0))
"""Between the two shafts at home [rad]: less hides depth, more makes one work backwards."""
FROM_THE_SIDE = 0.3
"""Smallest share of the instrument's shaft that lies across the scope's picture at home."""


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
"""Aims at any point of the instrument's box, 18 degrees to each side, at a calm picture's speed."""

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
            q = q_home
            for share in (0.5, 1.0):
                p = (1 - share) * depth * s + share * corner
                axis = p / np.linalg.norm(p)
                R = _between(s, axis) @ _turn(s, share * roll) @ R_home
                X = np.eye(4)
                X[:3, :3], X[:3, 3] = R, p_Rcm + p - R @ p_FTip
                reached = inverse(arm.chain, q, X, 20)
                if reached is None:
                    return None
                q = reached
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
    X_FTip = _tip_in_flange(arm)
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


def _tip_in_flange(arm: surg_core.Arm) -> Array:
    import surg_core

    mount, tip = arm.instrument.mount_link, arm.instrument.tip_link
    return np.asarray(surg_core.fixed_transform(arm.instrument_urdf, mount, tip))


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


def look_from(elevation: float = ELEVATION) -> Array:
    """Unit vector (3,) from the work point to the lenses in patient axes: towards -y, raised."""
    return np.array([0.0, -np.cos(elevation), np.sin(elevation)])


def suits(outwards: Array) -> bool:
    """Whether an instrument whose shaft leaves the work point so (3,) goes with the scope."""
    view = look_from()
    angle = float(np.arccos(np.clip(outwards @ view, -1.0, 1.0)))
    return ANGLES[0] <= angle <= ANGLES[1] and abs(float(outwards[0])) >= FROM_THE_SIDE


def stand_instrument(arm: surg_core.Arm, rng: np.random.Generator) -> Stand:
    """The instrument's arm: with its own home posture where that suits, else with a found one.

    Raises:
        RuntimeError: No base beside the table can hold the shaft there.
    """
    task = replace(INSTRUMENT, acceleration=arm.robot.limits.tip_acceleration)
    p_FTip, s_F = shaft_in_flange(arm)
    q = np.asarray(arm.robot.home)
    X = np.asarray(arm.chain.forward(q))
    s, tip = X[:3, :3] @ s_F, X[:3, :3] @ p_FTip + X[:3, 3]
    away = tip - task.depth * s  # patient x points from the base to the trocar, as in ``scene``
    yaw = -float(np.arctan2(away[1], away[0]))
    R = _turn(np.array([0.0, 0.0, 1.0]), yaw)
    left = reserve(arm, q, task)
    if left is not None and suits(-(R @ s)):
        return Stand(-(R @ tip), yaw, q, left)
    tilt, found = np.radians(23.0), []
    bases = [
        np.array([-x, y, z])
        for x in (0.42, 0.47)
        for y in (-0.1, 0.0, 0.1)
        for z in (-0.25, -0.18, -0.11, -0.04)
    ]
    for azimuth in np.radians([-10.0, 0.0]):
        u = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
        tips = []
        for roll in np.arange(8) * np.pi / 4:
            X = np.eye(4)
            X[:3, :3] = _turn(-u, roll) @ _between(np.array([0.0, 0.0, 1.0]), -u)
            tips.append(X)
        found += stands(arm, tips, bases, task, rng)[:1]
    if not found:
        raise RuntimeError(
            f"{arm.robot.name}: no base beside the table holds the instrument with its box in "
            "reach; a longer arm or a shorter instrument is needed"
        )
    best = max(found, key=lambda stand: stand.reserve.score)
    return replace(best, q=np.round(best.q, 4))


@dataclass(frozen=True)
class Nearness:
    """How near a robot comes to the other arm, to table and patient [m].

    Attributes:
        home: Both at home.
        corner: One of them in any corner of its box.
    """

    home: float
    corner: float


def stand_endoscope(
    arm: surg_core.Arm, other: surg_core.Arm, taken: Stand, rng: np.random.Generator
) -> tuple[Stand, Nearness]:
    """The endoscope's arm beside the instrument's, and how near the two come.

    Raises:
        RuntimeError: Every base is out of reach or too near to the other arm.
    """
    bases = [
        np.array([x, y, taken.base[2] + z])
        for x in (-0.68, -0.62, -0.56, -0.50, -0.44, 0.44, 0.50, 0.56, 0.62)
        for y in (-0.68, -0.61, -0.54, -0.47, -0.40)
        for z in (0.0, 0.1, 0.2)
    ]
    tip = scope_pose(np.zeros(3), look_from())
    best: tuple[float, Stand, Nearness] | None = None
    for stand in stands(arm, [tip], bases, ENDOSCOPE, rng, keep=150):
        if best is not None and stand.reserve.score <= best[0]:
            break  # the rest has less reserve than this one has with its clearance
        space = Neighbours([other, arm], [taken, stand])
        home = space.clearance(taken.q, stand.q)
        if home < CLEARANCE:
            continue
        corners = [(q, stand.q) for q in taken.reserve.postures]
        corners += [(taken.q, q) for q in stand.reserve.postures]
        near = Nearness(home, min(space.clearance(*pair) for pair in corners))
        score = min(stand.reserve.score, 8.0 * near.corner)
        if near.corner >= CORNER_CLEARANCE and (best is None or score > best[0]):
            best = score, stand, near
    if best is None:
        raise RuntimeError(
            f"{arm.robot.name} beside {other.robot.name}: every base is out of reach or nearer "
            f"than {1000 * CLEARANCE:.0f} mm to the other arm"
        )
    return best[1], best[2]


_OWN_HOME = "its own holds the shaft across the scope's view; this one has as much reserve"
_SCOPE_HOME = "the lenses 100 mm before the instrument's home tip, the picture upright"
_LIMITS = {
    "tip_velocity": (0.05, "m/s; the flange moves six times as fast as the lens"),
    "tip_jerk": (5.0, "m/s^3; a picture must not shake"),
    "roll_velocity": (0.6, "rad/s; the horizon turns with it"),
    "depth_max": (0.16, "m; 310 mm of shaft less the way to the camera head"),
}


@dataclass(frozen=True)
class Files:
    """What one arm is made of.

    Attributes:
        robot: Its robot's YAML.
        instrument: Its instrument's YAML.
    """

    robot: Path
    instrument: Path

    def load(self, name: str, depth: float) -> surg_core.Arm:
        """As the only arm of a cell of its own."""
        import surg_core
        from surg_description.make_cell import make_cell

        with tempfile.TemporaryDirectory() as folder:
            make_cell(self.robot, Path(folder) / "cell", self.instrument, depth, name)
            return surg_core.load_cell(Path(folder) / "cell").arms[name]


def make_two_arm_cell(out: Path, instrument: Files, scope: Files) -> str:
    """Find places for PSM1 with an instrument and ECM with an endoscope, and write the cell.

    Args:
        out: Folder to write; its name is the cell's name.
        instrument: Robot and instrument of PSM1.
        scope: Robot and endoscope of ECM.

    Returns:
        What was found, in words.

    Raises:
        RuntimeError: There is no place for one of them.
        ValueError: A file cannot be used.
    """
    from surg_description.make_cell import ArmPlan, make_cell_of

    rng = np.random.default_rng(0)
    psm, ecm = (
        instrument.load("PSM1", INSTRUMENT.depth),
        scope.load("ECM", ENDOSCOPE.depth),
    )
    first = stand_instrument(psm, rng)
    second, near = stand_endoscope(ecm, psm, first, rng)

    # PSM1's base is the world; what the file rounds is settled before the scope's posture is.
    X_WP = np.linalg.inv(first.X_PB)
    base = np.round((X_WP @ np.append(second.base, 1.0))[:3], 3)
    yaw = round(second.yaw - first.yaw, 3)
    X_WB = np.eye(4)
    X_WB[:3, :3], X_WB[:3, 3] = _turn(np.array([0.0, 0.0, 1.0]), yaw), base
    X_FTip = _tip_in_flange(ecm)
    X_BF = np.linalg.inv(X_WB) @ X_WP @ scope_pose(np.zeros(3), look_from()) @ np.linalg.inv(X_FTip)
    q = inverse(ecm.chain, second.q, X_BF)
    left = None if q is None else reserve(ecm, q, ENDOSCOPE)
    assert q is not None and left is not None  # half a millimetre beside a place that was good
    share = min(1.0, 1.0 / left.acceleration)
    limits = dict(_LIMITS)
    limits["tip_acceleration"] = (
        float(np.floor(100 * ENDOSCOPE.acceleration * share) / 100),
        "m/s^2; for the same reason",
    )
    _, s_F = shaft_in_flange(psm)
    outwards = -(first.X_PB @ np.asarray(psm.chain.forward(first.q)))[:3, :3] @ s_F
    angle = float(np.degrees(np.arccos(outwards @ look_from())))
    said = (
        f"The shafts meet at {angle:.0f} degrees; a robot comes no nearer to the other arm than "
        f"{1000 * near.home:.0f} mm at home and {1000 * near.corner:.0f} mm in a corner of its box."
    )
    own = bool(np.abs(first.q - np.asarray(psm.robot.home)).max() < 1e-9)
    plans = {
        "PSM1": ArmPlan(
            instrument.robot,
            instrument.instrument,
            INSTRUMENT.depth,
            home=None if own else first.q.tolist(),
            home_reason=_OWN_HOME,
        ),
        "ECM": ArmPlan(
            scope.robot,
            scope.instrument,
            ENDOSCOPE.depth,
            base_xyz=base.tolist(),
            base_rpy=(0.0, 0.0, yaw),
            home=q.tolist(),
            home_reason=_SCOPE_HOME,
            limits=limits,
        ),
    }
    note = f"PSM1 holds the instrument, ECM the endoscope; placed by base_placement. {said}"
    make_cell_of(out, plans, "\n".join(textwrap.wrap(note, 98)))
    return f"{said} Reserve: PSM1 {_words(first.reserve)}; ECM {_words(left)}."


def _words(left: Reserve) -> str:
    return (
        f"{left.margin:.2f} rad to a joint's limit, at most {100 * left.speed:.0f} % of a joint's "
        f"speed and {100 * left.acceleration:.0f} % of its acceleration"
    )


def main(words: Sequence[str] | None = None) -> int:
    """Place two robots beside a patient and write the cell."""
    parser = argparse.ArgumentParser(
        prog="surg_sim.physics.base_placement", description=main.__doc__
    )
    parser.add_argument("out", type=Path, help="folder of the cell to write")
    for option, what in (("--psm", "the instrument"), ("--ecm", "the endoscope")):
        parser.add_argument(
            option,
            nargs=2,
            type=Path,
            required=True,
            metavar=("ROBOT.yaml", "INSTRUMENT.yaml"),
            help=f"robot that holds {what}",
        )
    options = parser.parse_args(words)
    try:
        print(make_two_arm_cell(options.out, Files(*options.psm), Files(*options.ecm)))
    except (ValueError, OSError, RuntimeError) as error:
        print(f"surg_sim.physics.base_placement: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
