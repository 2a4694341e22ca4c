"""Search for a home posture of one arm: the one with the largest reserve round it.

Tip poses in front of the base are drawn, with the shaft pointing down at up to 50 degrees from the
vertical, as the cell mounts the arm. Those that the arm can hold away from its joint limits are
ranked by the terms that `robot check` judges, and the best are improved by small random changes.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

import surg_core
from surg_core import axis_angle_to_matrix
from surg_sim.arrays import Array
from surg_sim.physics.sim_arm import tip_in_flange
from surg_sim.placement.arm_reserve import ENDOSCOPE, INSTRUMENT, Reserve, inverse, reserve
from surg_sim.placement.placement_search import elbow_up, in_range

MOST_TILT = np.radians(50.0)
"""Largest angle of the shaft from straight down at home [rad]."""
LEAST_MARGIN = 0.3
"""Smallest distance of a joint from its limit at home [rad]."""
LEAST_SINGULAR = 0.1
"""Smallest singular value of the flange Jacobian of a good home."""
_UPRIGHT = 0.5  # cosine of a base's tilt up to which the arm works above its mounting plane

_JUDGED = 30  # of the candidates, the least singular ones
_IMPROVED = 3
_PATIENCE = 4  # times as many changes where the best home is not good enough


@dataclass(frozen=True)
class Term:
    """One thing that is asked of a home."""

    share: float  # what there is of what is needed; 1 is enough
    text: str  # what there is, what is needed, and what would do


@dataclass(frozen=True)
class Home:
    """A home posture and what the arm has left there."""

    q: Array  # (n,) [rad]
    tilt: float  # of the shaft from straight down [rad]
    reserve: Reserve
    terms: tuple[Term, ...]

    @property
    def score(self) -> float:
        """The weakest of all terms: a good home has 1 or more."""
        return min(term.share for term in self.terms)


def judge(arm: surg_core.Arm, q: Array) -> Home | None:
    """A posture as home; None: the arm cannot reach its workspace from there."""
    workspace = ENDOSCOPE if arm.instrument.camera is not None else INSTRUMENT
    limit = float(arm.limits.tip_acceleration)
    left = reserve(arm, q, replace(workspace, acceleration=limit))
    if left is None:
        return None
    tilt = tilt_of(arm, q)
    good = math.floor(100.0 * limit / left.acceleration) / 100.0
    terms = (
        Term(
            MOST_TILT / max(tilt, 1e-9),
            f"the shaft is {np.degrees(tilt):.0f} deg from vertical; allowed are "
            f"{np.degrees(MOST_TILT):.0f}",
        ),
        Term(
            left.margin / LEAST_MARGIN,
            f"a joint comes within {left.margin:.2f} rad of its limit; {LEAST_MARGIN} are needed",
        ),
        Term(
            left.singular / LEAST_SINGULAR,
            f"singular value {left.singular:.3f}; {LEAST_SINGULAR} is needed",
        ),
        Term(
            1.0 / left.speed,
            f"{100 * left.speed:.0f} % of a joint's speed at {workspace.speed} m/s and "
            f"{workspace.roll_speed:g} rad/s; allowed are 100 %: raise joints.velocity, if the arm "
            "is faster",
        ),
        Term(
            1.0 / left.acceleration,
            f"{100 * left.acceleration:.0f} % of a joint's acceleration at limits.tip_acceleration "
            f"{limit:g}; allowed are 100 %: {good:g} m/s^2 would do at this home",
        ),
    )
    return Home(q, tilt, left, terms)


def tilt_of(arm: surg_core.Arm, q: Array) -> float:
    """Angle of the shaft from straight down [rad]."""
    X_BTip = np.asarray(arm.chain.forward(q)) @ tip_in_flange(arm)
    return float(np.arccos(np.clip(-(_up(arm) @ X_BTip[:3, 2]), -1.0, 1.0)))


def search(arm: surg_core.Arm, seed: int = 0, draws: int = 400, rounds: int = 40) -> Home:
    """The best home found.

    Args:
        arm: Its present home is one of the candidates; its base says where up is.
        seed: Of the draws; the same seed finds the same home.
        draws: Tip poses to try.
        rounds: Small changes to try on each of the best postures.

    Raises:
        ValueError: No drawn posture can hold the workspace; says what fails.
    """
    rng = np.random.default_rng(seed)
    seen: Counter[str] = Counter()
    candidates: list[tuple[float, Array]] = []
    for number in range(draws):
        q = _draw(arm, rng, own_range=number % 2 == 1)
        why = "unreached" if q is None else _refused(arm, q)
        seen[why] += 1
        if q is not None and not why:
            J = np.asarray(arm.chain.jacobian(q))
            candidates.append((float(np.linalg.svd(J, compute_uv=False)[5]), q))
    candidates.sort(key=lambda item: -item[0])
    postures = [q for _, q in candidates[:_JUDGED]]
    present = np.asarray(arm.robot.home)
    postures += [] if _refused(arm, present) else [present]
    homes = [home for q in postures if (home := judge(arm, q)) is not None]
    if not homes:
        raise ValueError(
            f"no posture holds the workspace with the shaft down. Of {draws} drawn tip poses the "
            f"arm does not reach {seen['unreached']}; a joint is within {LEAST_MARGIN} rad of its "
            f"limit in {seen['limit']}, the shaft too flat in {seen['tilt']}, the forearm too low "
            f"in {seen['elbow']}; {len(candidates)} leave no room for the tip"
        )
    homes = sorted(homes, key=lambda home: -home.score)[:_IMPROVED]
    for _ in range(_PATIENCE):
        homes = [_improve(arm, home, rng, rounds) for home in homes]
        best = max(homes, key=lambda home: home.score)
        if best.score >= 1.0:
            break
    return best


def _improve(arm: surg_core.Arm, home: Home, rng: np.random.Generator, rounds: int) -> Home:
    """Small changes that raise the score."""
    scale = 0.15
    for _ in range(rounds):
        q = home.q + rng.normal(scale=scale, size=len(home.q))
        other = None if _refused(arm, q) else judge(arm, q)
        if other is not None and other.score > home.score:
            home = other
        else:
            scale = max(0.9 * scale, 0.02)
    return home


def _draw(arm: surg_core.Arm, rng: np.random.Generator, own_range: bool) -> Array | None:
    """A posture with the tip in front of the base and the shaft down; None: not reached.

    The solution starts near the present home, or anywhere in each joint's own range.
    """
    far, up = _stretched(arm), _up(arm)
    upright = up[2] > _UPRIGHT
    distance, height = rng.uniform(0.25, 0.8) * far, rng.uniform(-0.2, 0.4) * far
    azimuth, tilt, spin = (
        rng.uniform(-0.5, 0.5),
        rng.uniform(0.0, MOST_TILT),
        rng.uniform(-3.2, 3.2),
    )
    down = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    X = np.eye(4)
    about = rng.uniform(-np.pi, np.pi)
    X[:3, :3] = (
        axis_angle_to_matrix([np.cos(about), np.sin(about), 0.0], tilt)
        @ down
        @ axis_angle_to_matrix([0.0, 0.0, 1.0], spin)
    )
    below = 0.0 if upright else 0.5 * far  # an arm on a wall or ceiling works below its base
    X[:3, 3] = [distance * np.cos(azimuth), distance * np.sin(azimuth), height - below]
    # Of axes that point ahead, to the left and up: ahead is the base's x, or away from the wall.
    ahead = np.eye(3)[0 if abs(up[2]) > _UPRIGHT else 2]
    ahead = ahead - (up @ ahead) * up
    ahead /= np.linalg.norm(ahead)
    X_BA = np.eye(4)
    X_BA[:3, :3] = np.column_stack([ahead, np.cross(up, ahead), up])
    home = np.asarray(arm.robot.home)
    start = home + rng.normal(scale=0.8, size=len(home))
    if own_range:
        start = rng.uniform(arm.robot.position_min, arm.robot.position_max)
    q = inverse(arm.chain, start, X_BA @ X @ np.linalg.inv(tip_in_flange(arm)))
    return None if q is None else in_range(arm, q)


def _up(arm: surg_core.Arm) -> Array:
    """The vertical in the base frame (3,)."""
    return np.asarray(arm.X_WB_stated[2, :3])


def _refused(arm: surg_core.Arm, q: Array) -> str:
    """Why a posture is no candidate: limit, tilt or elbow; empty: it is one."""
    low, high = np.asarray(arm.robot.position_min), np.asarray(arm.robot.position_max)
    if np.any(q <= low + LEAST_MARGIN) or np.any(q >= high - LEAST_MARGIN):
        return "limit"
    if tilt_of(arm, q) > MOST_TILT:
        return "tilt"
    up, floor = _up(arm), 0.0
    if up[2] <= _UPRIGHT:  # the patient, not the wall or ceiling
        X_BTip = np.asarray(arm.chain.forward(q)) @ tip_in_flange(arm)
        floor = float(up @ (X_BTip[:3, 3] - INSTRUMENT.depth * X_BTip[:3, 2]))
    return "" if elbow_up(arm, q, up, floor) else "elbow"


def _stretched(arm: surg_core.Arm) -> float:
    """How far the flange comes from the base, about [m]."""
    rng = np.random.default_rng(0)
    low, high = np.asarray(arm.robot.position_min), np.asarray(arm.robot.position_max)
    flanges = (np.asarray(arm.chain.forward(rng.uniform(low, high))) for _ in range(200))
    return max(float(np.linalg.norm(X[:3, 3])) for X in flanges)
