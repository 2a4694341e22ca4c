"""Free-run: set-points between two steps of a chunk.

A stream at 20 Hz makes the controller's stream filter guess the velocity from points 50 ms apart,
and overshoot where the motion ends. The steps that are to come are known here, so the way between
them is sent at a higher rate: cubic Hermite pieces whose slopes are limited as by Fritsch and
Carlson (SIAM J. Numer. Anal. 17, 1980), so that no number of a target leaves the range between the
two steps. In lock-step nothing is sent between two steps: a roll-out stays what an environment in
one process computes from the same actions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from surg_policy_bridge.server.policy_arm import Target

Array = NDArray[np.float64]

SEND = 8_000_000
"""[ns] Between two set-points: four control periods, 125 Hz."""
_STEEPEST = 3.0
"""Of the secant: a piece with slopes below is monotone (Fritsch and Carlson)."""


class Piece:
    """The way from one target to the next.

    Args:
        start: Where it begins.
        goal: Where it ends.
        slope: Of each number at the start, per piece, (5,).
        beyond: The step after the goal, if it is known: the slope at the end looks ahead to it.
    """

    def __init__(self, start: Target, goal: Target, slope: Array, beyond: Target | None) -> None:
        self._from = start
        way = _way(start, goal)
        after = way if beyond is None else _way(goal, beyond)
        self._way = way
        self._in = _limited(slope, way)
        self._out = _limited(_limited(0.5 * (way + after), way), after)
        self.goal = goal

    @property
    def slope(self) -> Array:
        """Of each number at the end, per piece, (5,)."""
        return self._out

    def at(self, share: float) -> Target:
        """The target after a share of the piece's time, 0 to 1."""
        u = min(max(share, 0.0), 1.0)
        rise = u * u * (3.0 - 2.0 * u)
        moved = rise * self._way + u * (1 - u) * ((1 - u) * self._in - u * self._out)
        start = self._from
        return Target(start.p + moved[:3], start.roll + moved[3], start.jaw + moved[4])


def _way(start: Target, goal: Target) -> Array:
    """From one target to another, (5,); the roll goes the shorter way."""
    way = goal.row - start.row
    way[3] = math.remainder(way[3], math.tau)
    return way


def _limited(slope: Array, way: Array) -> Array:
    """Slopes that keep a piece between its ends."""
    most = _STEEPEST * np.abs(way)
    return np.where(slope * way > 0.0, np.clip(slope, -most, most), 0.0)
