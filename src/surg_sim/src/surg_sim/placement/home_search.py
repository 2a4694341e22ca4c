"""Search for a home posture of one arm: the one with the largest reserve round it.

Tip poses in front of the base are drawn, with the shaft pointing down at up to 50 degrees from the
vertical. Those that the arm can hold away from its joint limits are ranked by ``arm_reserve``, and
the best ones are improved by small random changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import surg_core
from surg_core import axis_angle_to_matrix
from surg_sim.arrays import Array
from surg_sim.physics.sim_arm import tip_in_flange
from surg_sim.placement.arm_reserve import INSTRUMENT, Reserve, inverse, reserve
from surg_sim.placement.placement_search import elbow_up

MOST_TILT = np.radians(50.0)
"""Largest angle of the shaft from straight down at home [rad]."""
LEAST_MARGIN = 0.3
"""Smallest distance of a joint from its limit at home [rad]."""

_JUDGED = 30  # of the candidates, the least singular ones
_IMPROVED = 3


@dataclass(frozen=True)
class Home:
    """A home posture and what the arm has left there."""

    q: Array  # (n,) [rad]
    tilt: float  # of the shaft from straight down [rad]
    reserve: Reserve


def judge(arm: surg_core.Arm, q: Array) -> Home | None:
    """A posture as home; None: the arm cannot reach its workspace from there."""
    workspace = replace(INSTRUMENT, acceleration=float(arm.limits.tip_acceleration))
    left = reserve(arm, q, workspace)
    return None if left is None else Home(q, tilt_of(arm, q), left)


def tilt_of(arm: surg_core.Arm, q: Array) -> float:
    """Angle of the shaft from straight down [rad]."""
    X_BTip = np.asarray(arm.chain.forward(q)) @ tip_in_flange(arm)
    return float(np.arccos(np.clip(-X_BTip[2, 2], -1.0, 1.0)))


def search(arm: surg_core.Arm, seed: int = 0, draws: int = 400, rounds: int = 40) -> Home | None:
    """The best home found; None: no drawn posture can hold the workspace.

    Args:
        arm: Its present home is only a start value.
        seed: Of the draws; the same seed finds the same home.
        draws: Tip poses to try.
        rounds: Small changes to try on each of the best postures.
    """
    rng = np.random.default_rng(seed)
    candidates: list[tuple[float, Array]] = []
    for _ in range(draws):
        q = _draw(arm, rng)
        if q is not None:
            J = np.asarray(arm.chain.jacobian(q))
            candidates.append((float(np.linalg.svd(J, compute_uv=False)[5]), q))
    candidates.sort(key=lambda item: -item[0])
    homes = [home for _, q in candidates[:_JUDGED] if (home := judge(arm, q)) is not None]
    homes.sort(key=lambda home: -home.reserve.score)
    improved = [_improve(arm, home, rng, rounds) for home in homes[:_IMPROVED]]
    improved.sort(key=lambda home: -home.reserve.score)
    return improved[0] if improved else None


def _improve(arm: surg_core.Arm, home: Home, rng: np.random.Generator, rounds: int) -> Home:
    """Small changes that raise the reserve."""
    scale = 0.15
    for _ in range(rounds):
        q = home.q + rng.normal(scale=scale, size=len(home.q))
        other = judge(arm, q) if _allowed(arm, q) else None
        if other is not None and other.reserve.score > home.reserve.score:
            home = other
        else:
            scale = max(0.9 * scale, 0.02)
    return home


def _draw(arm: surg_core.Arm, rng: np.random.Generator) -> Array | None:
    """A posture with the tip in front of the base and the shaft down; None: not reached."""
    far = _stretched(arm)
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
    X[:3, 3] = [distance * np.cos(azimuth), distance * np.sin(azimuth), height]
    home = np.asarray(arm.robot.home)
    start = home + rng.normal(scale=0.8, size=len(home))
    q = inverse(arm.chain, start, X @ np.linalg.inv(tip_in_flange(arm)))
    if q is None:
        return None
    q = (q + np.pi) % (2 * np.pi) - np.pi
    return q if _allowed(arm, q) else None


def _allowed(arm: surg_core.Arm, q: Array) -> bool:
    low, high = np.asarray(arm.robot.position_min), np.asarray(arm.robot.position_max)
    inside = bool(np.all(q > low + LEAST_MARGIN) and np.all(q < high - LEAST_MARGIN))
    return inside and tilt_of(arm, q) <= MOST_TILT and elbow_up(arm, q)


def _stretched(arm: surg_core.Arm) -> float:
    """How far the flange comes from the base, about [m]."""
    rng = np.random.default_rng(0)
    low, high = np.asarray(arm.robot.position_min), np.asarray(arm.robot.position_max)
    flanges = (np.asarray(arm.chain.forward(rng.uniform(low, high))) for _ in range(200))
    return max(float(np.linalg.norm(X[:3, 3])) for X in flanges)
