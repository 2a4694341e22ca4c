"""Where the tip goes: rest, and 5 mm to either side along each of the camera's axes.

View frame V: the optical axes of the left eye, x right, y down, z away from the viewer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIDE = 0.005
"""[m] To either side of rest."""
SPEED = 0.020
"""[m/s] Largest speed of the tip: a person can follow it, and stop it."""
AXES = (0, 1, 2)
"""x, y, z of V."""
WORDS = {
    (0, 1): "right",
    (0, -1): "left",
    (1, 1): "down",
    (1, -1): "up",
    (2, 1): "away",
    (2, -1): "nearer",
}
"""What a viewer calls the way along an axis."""


class Step(NamedTuple):
    """A place on the way: the axis and the side of it; side 0 is rest."""

    axis: int
    side: int

    def __str__(self) -> str:
        """The word for it."""
        return WORDS.get((self.axis, self.side), "rest")

    def offset(self, side: float = SIDE) -> Array:
        """(3,) from rest, in V [m]."""
        return np.asarray(side * self.side * np.eye(3)[self.axis])


REST = Step(0, 0)
STEPS = (REST, *(Step(axis, side) for axis in AXES for side in (1, -1)))
"""In the order in which they are visited; afterwards the tip goes back to rest."""


def between(start: Array, end: Array, t: float, speed: float = SPEED) -> tuple[Array, bool]:
    """A place on the straight way from start to end, from rest to rest.

    The way's share is 3 s^2 - 2 s^3 of the time's share s: at most 1.5 times the mean speed.

    Args:
        start: (3,) [m].
        end: (3,) [m].
        t: Since the start [s].
        speed: Largest on the way [m/s].

    Returns:
        The place (3,) [m], and whether it is the end.
    """
    duration = 1.5 * float(np.linalg.norm(end - start)) / speed
    if t >= duration:
        return np.array(end), True
    share = max(t, 0.0) / duration
    return np.asarray(start + (3.0 - 2.0 * share) * share**2 * (end - start)), False
