"""A script that brings what the jaws hold into a hole: look, aim, go in, draw back, try again."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Generator, Iterator

import numpy as np

import surg_core
from surg_sim.arrays import Array
from surg_sim.tasks.scripted_arm import ArmExpert

ATTEMPTS = 8
HAND = 0.001
"""Error of the hand at the hole per axis, one sigma [m]."""


class HoleExpert(ArmExpert):
    """At the robot's console.

    Attributes:
        far: Distance before the hole at the first look [m].
        near: Distance before the hole at the later looks [m].
        looks: Number of looks before the hole; each halves the hand's error.
    """

    far: float
    near: float
    looks: int

    def __init__(self, cell: surg_core.Cell, seed: int, arm: str) -> None:
        super().__init__(cell, seed, arm)
        self._error = self.rng.normal(scale=HAND, size=3)
        self._reaction = float(self.rng.uniform(0.2, 0.6))

    @abstractmethod
    def _look(self) -> None:
        """See the hole, and how the thing lies in the jaws."""

    @abstractmethod
    def _target(self, ahead: float) -> tuple[Array, Array]:
        """Place of the tip [m] and its turns with the thing's end ``ahead`` of the hole [m]."""

    @abstractmethod
    def _clear_way(self) -> Array:
        """Direction (3,) along which the thing is kept away from the hole's body at first."""

    @abstractmethod
    def _enter(self) -> Generator[None, None, bool]:
        """Go into the hole; returns whether it went through, else the thing is outside again."""

    def script(self) -> Iterator[None]:
        """See ``ArmExpert``."""
        self.jaw = self.jaw_closed
        yield from self.wait(self._reaction)
        yield from self._approach()
        for _ in range(ATTEMPTS):
            for _ in range(self.looks):
                yield from self._go(self.near, 0.5)
                self._error = 0.5 * self._error
                yield from self.wait(self._reaction)
            if (yield from self._enter()):
                return

    def _approach(self) -> Iterator[None]:
        """Turn far away, go past the hole, and only then towards it: the thing is large."""
        self._look()
        p, turns = self._target(self.far)
        self.roll.go(turns)
        while not self.roll.arrived:
            yield
        way = self._clear_way()
        yield from self.move(p - way * ((p - self.observation.point("tip")) @ way))
        yield from self._go(self.far, 1.0)

    def _go(self, ahead: float, seconds: float) -> Iterator[None]:
        """Look, and bring the thing to a distance before the hole [m]."""
        self._look()
        p, turns = self._target(ahead)
        self.roll.go(turns, seconds)
        yield from self.move(p, seconds)
        while not self.roll.arrived:
            yield

    def _put(self, p: Array, turns: Array) -> None:
        """The next set-point: tip in the world [m], and its turns."""
        self.path.stay(self.local(p))
        self.roll.stay(turns)


def turn_onto(axis: Array, d: Array, s: Array) -> float:
    """Angle about the shaft s that turns d into the plane of s and the axis [rad]; unit vectors."""
    return float(np.arctan2(axis @ np.cross(s, d), axis @ (d - (d @ s) * s)))
