"""The way of a link's arm from a velocity to rest.

A robot's joints lag behind their targets, each by its own time. A controller holds a pivot with the
measured joints, so the targets are beside it. Targets that merely come to rest would take the arm
there: 0.2 mm at a tip speed of 50 mm/s with lags of 5 to 8.5 ms. The ramp therefore takes back how
far the targets are ahead, except along the way of the arm.
"""

from __future__ import annotations

from collections.abc import Sequence

LEAST = 0.03
"""[s] Shortest time in which the targets are taken back."""
LARGEST_LAG = 0.005
"""[s] Times the leading velocity: a joint's target is taken back by no more than that."""


class StopRamp:
    """Velocities to rest along a straight line of the measured joints.

    Args:
        start: Velocity sent last [rad/s].
        ahead: Targets minus measured angles [rad]; empty: unknown.
        deceleration: Of the leading joint [rad/s^2].
    """

    def __init__(self, start: Sequence[float], ahead: Sequence[float], deceleration: float) -> None:
        self._start = tuple(start)
        leading = max(abs(each) for each in self._start)
        self._braking = leading / deceleration
        self._back = _beside(ahead, self._start, LARGEST_LAG * leading)
        self._duration = max(self._braking, LEAST) if any(self._back) else self._braking
        self._time = 0.0

    def velocity(self, elapsed: float) -> tuple[float, ...]:
        """The velocity for the next cycle [rad/s], this long after the last one [s]."""
        before, self._time = self._time, self._time + elapsed
        if before >= self._duration:
            return tuple(0.0 for _ in self._start)
        share = max(0.0, 1.0 - self._time / self._braking)
        taken = (self._taken(self._time) - self._taken(before)) / elapsed
        return tuple(
            share * u - taken * back for u, back in zip(self._start, self._back, strict=True)
        )

    def _taken(self, time: float) -> float:
        """Share of the way back after this time: smooth, from 0 to 1."""
        s = min(time / self._duration, 1.0)
        return s * s * (3.0 - 2.0 * s)


def _beside(ahead: Sequence[float], way: Sequence[float], most: float) -> tuple[float, ...]:
    """The part of a vector perpendicular to the way, at most so long in each joint."""
    square = sum(u * u for u in way)
    if len(ahead) != len(way) or square == 0.0:
        return tuple(0.0 for _ in way)
    along = sum(e * u for e, u in zip(ahead, way, strict=True)) / square
    beside = [e - along * u for e, u in zip(ahead, way, strict=True)]
    return tuple(min(max(each, -most), most) for each in beside)
