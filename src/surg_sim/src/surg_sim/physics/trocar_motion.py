"""A trocar that moves by itself: breathing, a push from outside, and what a tracker sees of it.

The hole at rest is displaced by a jump and a sinusoid. A tracker (a camera, an ultrasound probe)
reports where the hole was some ticks ago; the ground truth is where it is now.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from surg_core.contract import TICK
from surg_sim.arrays import Array

MAX_STALE = 500
"""Oldest observation that a tracker can give [ticks]: 1 s."""


@dataclass(frozen=True)
class Sinusoid:
    """A motion of the hole at rest: amplitude * sin(2 pi frequency t) along one axis."""

    amplitude: float  # [m]; 5 mm is a large respiratory motion at a trocar
    frequency: float  # [1/s]; 0.25 is fifteen breaths a minute
    # Direction in the arm's base frame, of any length but zero.
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)

    def at(self, t: float) -> tuple[Array, Array]:
        """Offset [m] and velocity [m/s] at t [s] after the start, base frame, each (3,)."""
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        angular = 2.0 * np.pi * self.frequency
        offset = self.amplitude * np.sin(angular * t) * axis
        return offset, self.amplitude * angular * np.cos(angular * t) * axis


class MovingPoint:
    """The hole at rest over time, first at p_B (3,) [m], base frame; with a memory for trackers."""

    def __init__(self, p_B: Array) -> None:
        self._start = np.array(p_B, dtype=np.float64)
        self.reset()

    def reset(self) -> None:
        """Back to the start, at rest, at tick 1."""
        self._centre = self._start
        self._still: Array | None = None
        self._motion: Sinusoid | None = None
        self._began = self.tick = 1
        self.p_B = self._start
        self.v_B = np.zeros(3)
        self._seen: deque[tuple[int, Array, Array]] = deque(maxlen=MAX_STALE + 1)
        self._seen.append((1, self.p_B, self.v_B))

    def move(self, motion: Sinusoid | None) -> None:
        """Begin a motion from where the hole is now; None: stay here."""
        self._centre, self._motion, self._began = self.p_B, motion, self.tick
        self._still = None

    def jump(self, offset: Array) -> None:
        """Displace it at once [m], base frame, (3,): seen from the next tick on."""
        self._centre = self._centre + np.asarray(offset, dtype=np.float64)
        self._still = None

    def advance(self) -> None:
        """One tick on. At rest, ``p_B`` and ``v_B`` stay the objects that they are."""
        self.tick += 1
        if self._motion is not None:
            offset, self.v_B = self._motion.at((self.tick - self._began) * TICK)
            self.p_B = self._centre + offset
        elif self._still is None:
            self.p_B = self._still = self._centre + np.zeros(3)
            self.v_B = np.zeros(3)
        self._seen.append((self.tick, self.p_B, self.v_B))

    def observed(self, stale: int) -> tuple[int, Array, Array]:
        """What was true ``stale`` ticks ago: tick, point [m], velocity [m/s].

        In the first ticks, the state at tick 1.
        """
        return self._seen[max(0, len(self._seen) - 1 - stale)]
