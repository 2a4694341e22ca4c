"""Searches base placements for two robots that share a patient.

The shafts of instrument and scope get the poses a surgeon would choose. Every base beside the table
that can hold its shaft there is tried, and the one with the largest reserve is taken. The reserve
is the worst, over the corners of a box around the home tip and three rolls, of what is left of each
joint's range, speed and acceleration. Placements too close to the other arm, the table or the
patient are rejected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import surg_core
from surg_core import axis_angle_to_matrix
from surg_core.transforms import minimal_rotation
from surg_sim.arrays import Array
from surg_sim.physics.sim_arm import tip_in_flange
from surg_sim.physics.trocar import shaft_in_flange
from surg_sim.placement.arm_clearance import ClearanceModel
from surg_sim.placement.arm_reserve import (
    ENDOSCOPE,
    INSTRUMENT,
    Reserve,
    Workspace,
    inverse,
    reserve,
)

VIEW = 0.100
"""Distance from the scope's lenses to the work point at home [m]."""
ELEVATION = np.radians(42.0)
"""Elevation of the scope at home above the horizontal [rad]."""
CLEARANCE = 0.04
"""Smallest distance of a robot to the other arm, table and patient, both arms at home [m]."""
CORNER_CLEARANCE = 0.02
"""The same with one arm in any corner of its workspace [m]."""
ANGLES = (np.radians(45.0), np.radians(90.0))
"""Smallest and largest angle between the two shafts at home [rad]."""
UP = np.array([0.0, 0.0, 1.0])
"""The vertical in the frame of a base that stands upright."""
FROM_THE_SIDE = 0.3
"""Smallest share of the instrument's shaft across the scope's picture at home."""


def scope_pose(work: Array, outwards: Array) -> Array:
    """Pose (4, 4) of the scope's tip that looks at the work point (3,) [m], its picture upright.

    The unit vector (3,) points from the work point to the lenses.
    """
    right = np.cross(-outwards, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.column_stack([right, np.cross(-outwards, right), -outwards])
    return surg_core.make_pose(work + VIEW * outwards, R)


def upright(p: Array, yaw: float) -> Array:
    """Pose (4, 4) at p (3,) [m], turned by yaw [rad] about the vertical."""
    return surg_core.make_pose(p, axis_angle_to_matrix([0.0, 0.0, 1.0], yaw))


@dataclass(frozen=True)
class Placement:
    """Base and home posture of one arm."""

    base: Array  # position of the base from the work point, patient axes, (3,) [m]
    yaw: float  # of the base [rad]
    q: Array  # home posture, (n,) [rad]
    reserve: Reserve  # reserve of the arm there

    @property
    def X_PB(self) -> Array:
        """Pose of the base in the patient's frame at the work point, (4, 4)."""
        return upright(self.base, self.yaw)


def find_placements(
    arm: surg_core.Arm,
    tips: Sequence[Array],
    bases: Sequence[Array],
    workspace: Workspace,
    rng: np.random.Generator,
    keep: int = 40,
) -> list[Placement]:
    """Placements that hold the tip at one of the poses, best first.

    Args:
        arm: The arm.
        tips: Acceptable poses of the tip in the patient's frame, (4, 4) each.
        bases: Candidate positions of the base, (3,) each; the base faces the work point.
        workspace: What the arm must be able to do.
        rng: Draws the start values of the inverse kinematics.
        keep: How many of the least singular postures are evaluated in full.
    """
    X_FTip = tip_in_flange(arm)
    low, high = np.asarray(arm.robot.position_min), np.asarray(arm.robot.position_max)
    home = np.asarray(arm.robot.home)
    candidates: list[tuple[float, Array, float, Array]] = []
    for base in bases:
        yaw = round(float(np.arctan2(-base[1], -base[0])), 3)
        X_PB = upright(base, yaw)
        for tip in tips:
            X_BF = np.linalg.inv(X_PB) @ tip @ np.linalg.inv(X_FTip)
            for attempt in range(6):
                start = home + rng.normal(scale=1.0, size=len(home)) * (attempt > 0)
                q = inverse(arm.chain, start, X_BF)
                if q is None:
                    continue
                q = in_range(arm, q)
                if np.any(q < low + 0.3) or np.any(q > high - 0.3) or not elbow_up(arm, q):
                    continue
                J = np.asarray(arm.chain.jacobian(q))
                candidates.append((float(np.linalg.svd(J, compute_uv=False)[5]), base, yaw, q))
    candidates.sort(key=lambda item: -item[0])
    best = [
        Placement(base, yaw, q, remaining)
        for _, base, yaw, q in candidates[:keep]
        if (remaining := reserve(arm, q, workspace)) is not None
    ]
    return sorted(best, key=lambda placement: -placement.reserve.score)


def in_range(arm: surg_core.Arm, q: Array) -> Array:
    """The same posture with each joint's angle next to the middle of that joint's range [rad]."""
    middle = (np.asarray(arm.robot.position_min) + np.asarray(arm.robot.position_max)) / 2.0
    return np.asarray(q - 2 * np.pi * np.round((q - middle) / (2 * np.pi)))


def elbow_up(arm: surg_core.Arm, q: Array, up: Array = UP, floor: float = 0.0) -> bool:
    """Whether every joint from the second on stays 50 mm above a floor: no forearm in the drapes.

    ``up`` (3,) is the vertical in the base frame, the floor's height [m] counts along it.
    """
    return all(up @ _joint_origin(arm.chain, q, i) > floor + 0.05 for i in range(2, len(q)))


def _joint_origin(chain: surg_core.Chain, q: Array, i: int) -> Array:
    """The point of joint i's axis (3,) that is nearest to the flange, base frame [m]."""
    J, p = np.asarray(chain.jacobian(q)), np.asarray(chain.forward(q))[:3, 3]
    return np.asarray(p - np.cross(J[:3, i], J[3:, i]))  # v = w x (p - o)


def scope_direction() -> Array:
    """Unit vector (3,) from the work point to the lenses in patient axes: towards -y, raised."""
    return np.array([0.0, -np.cos(ELEVATION), np.sin(ELEVATION)])


def suits_scope(outwards: Array) -> bool:
    """Whether an instrument shaft with this outward direction (3,) goes with the scope."""
    view = scope_direction()
    angle = float(np.arccos(np.clip(outwards @ view, -1.0, 1.0)))
    return ANGLES[0] <= angle <= ANGLES[1] and abs(float(outwards[0])) >= FROM_THE_SIDE


def place_instrument(arm: surg_core.Arm, rng: np.random.Generator) -> Placement:
    """Place the instrument's arm, with its own home posture if that suits the scope.

    Raises:
        RuntimeError: No base beside the table can hold the shaft there.
    """
    workspace = replace(INSTRUMENT, acceleration=arm.robot.limits.tip_acceleration)
    p_FTip, s_F = shaft_in_flange(arm)
    q = np.asarray(arm.robot.home)
    X = np.asarray(arm.chain.forward(q))
    s, tip = X[:3, :3] @ s_F, X[:3, :3] @ p_FTip + X[:3, 3]
    # The patient's x points from the base to the trocar, as in ``scene``.
    away = tip - workspace.depth * s
    yaw = -float(np.arctan2(away[1], away[0]))
    R = axis_angle_to_matrix([0.0, 0.0, 1.0], yaw)
    own = reserve(arm, q, workspace)
    if own is not None and suits_scope(-(R @ s)):
        return Placement(-(R @ tip), yaw, q, own)
    tilt, best_of_azimuth = np.radians(23.0), []
    bases = [
        np.array([-x, y, z])
        for x in (0.42, 0.47)
        for y in (-0.1, 0.0, 0.1)
        for z in (-0.25, -0.18, -0.11, -0.04)
    ]
    for azimuth in np.radians([-10.0, 0.0]):
        u = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
        R = minimal_rotation(np.array([0.0, 0.0, 1.0]), -u)
        tips = [
            surg_core.make_pose(rotation=axis_angle_to_matrix(-u, roll) @ R)
            for roll in np.arange(8) * np.pi / 4
        ]
        best_of_azimuth += find_placements(arm, tips, bases, workspace, rng)[:1]
    if not best_of_azimuth:
        raise RuntimeError(
            f"{arm.robot.name}: no base beside the table holds the instrument with its box in "
            "reach; a longer arm or a shorter instrument is needed"
        )
    best = max(best_of_azimuth, key=lambda placement: placement.reserve.score)
    return replace(best, q=np.round(best.q, 4))


@dataclass(frozen=True)
class Clearances:
    """Smallest distances of a robot to the other arm, the table and the patient [m]."""

    home: float  # both at home
    corner: float  # one of them in any corner of its box


def place_endoscope(
    arm: surg_core.Arm, other: surg_core.Arm, taken: Placement, rng: np.random.Generator
) -> tuple[Placement, Clearances]:
    """Place the endoscope's arm beside the instrument's; also returns the clearances.

    Raises:
        RuntimeError: Every base is out of reach or too near to the other arm.
    """
    bases = [
        np.array([x, y, taken.base[2] + z])
        for x in (-0.68, -0.62, -0.56, -0.50, -0.44, 0.44, 0.50, 0.56, 0.62)
        for y in (-0.68, -0.61, -0.54, -0.47, -0.40)
        for z in (0.0, 0.1, 0.2)
    ]
    tip = scope_pose(np.zeros(3), scope_direction())
    best: tuple[float, Placement, Clearances] | None = None
    for placement in find_placements(arm, [tip], bases, ENDOSCOPE, rng, keep=150):
        if best is not None and placement.reserve.score <= best[0]:
            break  # the rest has less reserve than this one has with its clearance
        model = ClearanceModel([other, arm], [taken.X_PB, placement.X_PB])
        home = model.clearance(taken.q, placement.q)
        if home < CLEARANCE:
            continue
        corners = [(q, placement.q) for q in taken.reserve.postures]
        corners += [(taken.q, q) for q in placement.reserve.postures]
        near = Clearances(home, min(model.clearance(*pair) for pair in corners))
        score = min(placement.reserve.score, 8.0 * near.corner)
        if near.corner >= CORNER_CLEARANCE and (best is None or score > best[0]):
            best = score, placement, near
    if best is None:
        raise RuntimeError(
            f"{arm.robot.name} beside {other.robot.name}: every base is out of reach or nearer "
            f"than {1000 * CLEARANCE:.0f} mm to the other arm"
        )
    return best[1], best[2]
