"""What successive pictures of the endoscope say together; numpy only.

`View` knows how far the picture has shifted, `Memory` where the assistant pointed.
"""

from __future__ import annotations

import numpy as np

from surg_learn.bgr.keypoint_network import AT, AXIS, NEAR, OTHER_JAW, PLACE, square

Array = np.ndarray

PRIOR, FADE, EDGE, LEAST = 0.5, 0.93, 1.2, 0.06
"""Of the estimate of a picture's shift: weight of none, memory per picture, the largest coordinate
at which a tip counts, and the smallest shift that counts."""
REST = 0.02
"""A tip that moves less than this in `LAG` steps tells the shift [half picture heights]: a picture
is older than the joints, so a tip that moves is seen behind."""
BESIDE = 0.07
"""Distance of the two places that tell a direction, from the one between them."""
LAG = 4
"""Steps between two looks at the assistant, which tell whether it moves."""
STILL, SHUT = 0.012, 0.15
"""An assistant that points moves less than this in `LAG` steps [half picture heights], and its jaws
are less open than this [rad]."""
MOVED = 0.15
"""An assistant that points has moved at least so far since the beginning [half picture heights]."""
FIRST = 0.05
"""Weight of the first look, before anybody points."""


class View:
    """From places in the picture to points in the rcm frame, while the camera may have moved.

    Where the robot's tip is, its joints say. Where it should be in the picture, the camera's model
    says. Seen elsewhere, it tells how far the whole picture has shifted.

    Args:
        plane: (6, 3) from `square` of a place to the resting bowel's axis [m].
        lens: (3, 4) homogeneous projection of the rcm frame to places.
    """

    def __init__(self, plane: Array, lens: Array) -> None:
        self._plane, self._lens = plane, lens
        self._sum, self._weight = np.zeros(2), 0.0
        self._path: list[Array] = []

    def look(self, tip: Array, clear: float, p_RTip: Array) -> None:
        """Take where the robot's tip is seen, how clearly, and where its joints say it is.

        Args:
            tip: (2,) place.
            clear: 0 to 1.
            p_RTip: (3,) [m].
        """
        x = self._lens @ np.append(p_RTip, 1.0)
        should = x[:2] / x[2]
        self._path = [*self._path[-LAG:], should]
        if len(self._path) <= LAG or not (np.abs(should) < EDGE).all():
            return
        moved = max(float(np.linalg.norm(each - should)) for each in self._path)
        weight = clear**2 * np.exp(-0.5 * (moved / REST) ** 2)
        fade = FADE**weight
        self._sum = fade * self._sum + weight * (tip - should)
        self._weight = fade * self._weight + weight

    @property
    def shift(self) -> Array:
        """Of the picture, (2,); a small one is the eye's error."""
        shift: Array = self._sum / (self._weight + PRIOR)
        return shift if shift @ shift > LEAST**2 else np.zeros(2)

    def points(self, places: Array) -> Array:
        """Points on the resting bowel for places (N, 2): (N, 3) [m]."""
        return square(places - self.shift) @ self._plane

    def along(self, place: Array, axis: Array) -> Array:
        """Direction in space of an axis (2,) at a place (2,), unit vector (3,)."""
        ends = self.points(np.array([place - BESIDE * axis, place + BESIDE * axis]))
        way = ends[1] - ends[0]
        return np.asarray(way / max(float(np.linalg.norm(way)), 1e-6))


class Memory:
    """Where the assistant pointed: a mean over the pictures in which it does.

    The assistant points, and is gone before the robot arrives. What its pictures said stays.
    """

    def __init__(self) -> None:
        self._weight = 0.0
        self._sum = np.zeros(4)
        self._places: list[Array] = []
        self._first: Array | None = None

    def add(self, answer: Array) -> Array:
        """Take an answer of `Eye`, (SAID,).

        Returns:
            (6,): the place pointed at, the tube's direction there, both in the picture, how certain
            it is, 0 to 1, and whether the assistant points now, 0 to 1.
        """
        self._places = [*self._places[-LAG:], np.array(answer[PLACE])]
        moved = float(np.linalg.norm(self._places[-1] - self._places[0]))
        points = np.exp(-0.5 * (moved / STILL) ** 2) / (
            1.0 + np.exp(np.clip((answer[OTHER_JAW] - SHUT) / 0.03, -9, 9))
        )
        if self._first is None:
            self._first = self._places[0]
        begun = float(np.linalg.norm(self._places[-1] - self._first)) > MOVED
        points *= min(answer[NEAR] / 0.3, 1.0) * begun
        weight = points**2 if self._weight else FIRST
        self._weight += weight
        self._sum += weight * np.append(answer[AT], answer[AXIS])
        mean = self._sum / self._weight
        mean[2:] /= max(float(np.linalg.norm(mean[2:])), 1e-6)
        return np.concatenate([mean, [min(self._weight / 5.0, 1.0), points]])
