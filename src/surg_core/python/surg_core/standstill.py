"""Detects standstill in a stream of joint states and averages the pose over 0.5 s."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

REST_S = 0.5
"""Time that the arm must stand still [s]."""
STILL_RAD = 0.0005
"""Spread of every joint within that time [rad]: 0.5 mm at 1 m, sensor noise included."""
LATEST_S = 0.1
"""Largest age of the last joint state at the end of a rest [s]."""
MOVED_RAD = 0.02
"""Largest joint motion between two poses that count as different [rad]."""


def resting(states: Sequence[tuple[float, FloatArray]], end: float) -> FloatArray | None:
    """Mean joint positions (n,) of an arm that was at rest for `REST_S` before a time.

    Args:
        states: Time [s] and joint positions (n,) [rad], oldest first.
        end: The time, such as a picture's exposure [s].

    Returns:
        None: the arm moved, or the states do not span the time.
    """
    if not states or states[0][0] > end - REST_S or states[-1][0] < end - LATEST_S:
        return None
    window = np.array([q for time, q in states if end - REST_S <= time <= end])
    if len(window) < 3 or not np.all(np.ptp(window, axis=0) <= STILL_RAD):
        return None
    return np.asarray(window.mean(axis=0))


class Standstill:
    """Detector: takes joint states and returns the mean pose of each new standstill once.

    The first standstill counts. Another is new if one joint has moved by ``MOVED_RAD``.
    """

    def __init__(self) -> None:
        self._window: deque[tuple[float, FloatArray]] = deque()
        self._last: FloatArray | None = None

    def add(self, time: float, q: FloatArray) -> FloatArray | None:
        """Add a joint state (n,) [rad] at an increasing time [s]; a step back resets the detector.

        Returns the (n,) mean joint positions of a new standstill, or None.
        """
        q = np.asarray(q, dtype=np.float64)
        if not np.all(np.isfinite(q)) or (self._window and time <= self._window[-1][0]):
            self._window.clear()
            return None
        self._window.append((time, q))
        # One state at least as old as REST_S stays, so that the window spans it.
        while len(self._window) > 1 and self._window[1][0] <= time - REST_S:
            self._window.popleft()
        mean = resting(self._window, time)
        moved = mean is not None and (
            self._last is None or np.max(np.abs(mean - self._last)) >= MOVED_RAD
        )
        if not moved:
            return None
        self._last = mean
        return mean
