"""Probe motions: rest, and 5 mm to either side along each axis of the camera.

View frame V: the optical axes of the left eye, x right, y down, z away from the viewer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surg_core.arm_view import Array

SIDE = 0.005
"""[m] Distance from rest."""
SPEED = 0.020
"""[m/s] Largest speed of the tip; slow enough for a person to stop it."""
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
"""The viewer's word for each direction."""


class ProbeMove(NamedTuple):
    """A probe position: an axis and a side of it; side 0 is rest."""

    axis: int
    side: int

    def __str__(self) -> str:
        return WORDS.get((self.axis, self.side), "rest")

    def offset(self) -> Array:
        """(3,) from rest, in V [m]."""
        return np.asarray(SIDE * self.side * np.eye(3)[self.axis])


REST = ProbeMove(0, 0)
STEPS = (REST, *(ProbeMove(axis, side) for axis in AXES for side in (1, -1)))
"""In the order of visits; the tip returns to rest afterwards."""


def between(start: Array, end: Array, t: float) -> tuple[Array, bool]:
    """(3,) position [m] at a time t [s] on a line between two points, and whether it is the end.

    The share of the path is 3 s^2 - 2 s^3 for a share s of the time, so the largest speed is 1.5
    times the mean.
    """
    duration = 1.5 * float(np.linalg.norm(end - start)) / SPEED
    if t >= duration:
        return np.array(end), True
    share = max(t, 0.0) / duration
    return np.asarray(start + (3.0 - 2.0 * share) * share**2 * (end - start)), False
