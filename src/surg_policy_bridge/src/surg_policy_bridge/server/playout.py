"""Free-run: interpolates between two steps of a chunk.

Of a 20 Hz stream the controller knows one step at a time and goes straight to it. The coming steps
are known here, so the path between them is sent at 125 Hz as cubic Hermite pieces. Their slopes are
limited as by Fritsch and Carlson (SIAM J. Numer. Anal. 17, 1980), so no component leaves the range
between the two steps. Lock-step sends nothing between steps, so a roll-out equals that of an
environment in one process.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from surg_policy_bridge.server.policy_arm import Target

Array = NDArray[np.float64]

SEND = 8_000_000
"""[ns] Period of the set-points: four control periods."""
_STEEPEST = 3.0
"""Multiple of the secant up to which a piece is monotone (Fritsch and Carlson)."""


class Piece:
    """A cubic piece from one target to the next.

    Args:
        start: First target.
        goal: Last target.
        slope: At the start, per piece, (T,).
        beyond: The step after the goal, if known; it sets the slope at the end.
    """

    def __init__(self, start: Target, goal: Target, slope: Array, beyond: Target | None) -> None:
        self._from = start
        secant = _difference(start, goal)
        after = secant if beyond is None else _difference(goal, beyond)
        self._secant = secant
        self._in = _limited(slope, secant)
        self._out = _limited(_limited(0.5 * (secant + after), secant), after)
        self.goal = goal

    @property
    def slope(self) -> Array:
        """Slope at the end, per piece, (T,)."""
        return self._out

    def at(self, share: float) -> Target:
        """The set-point after a share of the piece's time, 0 to 1."""
        u = min(max(share, 0.0), 1.0)
        rise = u * u * (3.0 - 2.0 * u)
        moved = rise * self._secant + u * (1 - u) * ((1 - u) * self._in - u * self._out)
        return Target.of(self._from.row + moved, self._from.wrist)


def _difference(start: Target, goal: Target) -> Array:
    """From one target to another, (T,); the roll takes the shorter way."""
    difference = goal.row - start.row
    difference[3] = math.remainder(difference[3], math.tau)
    return difference


def _limited(slope: Array, secant: Array) -> Array:
    """Slopes that keep a piece between its ends."""
    limit = _STEEPEST * np.abs(secant)
    return np.where(slope * secant > 0.0, np.clip(slope, -limit, limit), 0.0)
