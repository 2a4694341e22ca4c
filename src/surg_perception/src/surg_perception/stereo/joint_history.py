"""The newest joint states of an arm, and where it was when a picture was taken. No ROS."""

from __future__ import annotations

from collections import deque

import numpy as np

from surg_core.transforms import FloatArray

KEPT_NS = 1_000_000_000
MOST_GAP_NS = 100_000_000
"""Farthest that a joint state may lie from a picture's stamp."""

State = tuple[int, FloatArray]
"""Stamp [ns] and values (n,)."""


def between(before: State, after: State, stamp_ns: int) -> FloatArray | None:
    """The values (n,) at a time between two states; None: they lie too far apart."""
    if after[0] - before[0] > MOST_GAP_NS:
        return None
    share = (stamp_ns - before[0]) / (after[0] - before[0])
    return np.asarray(before[1] + share * (after[1] - before[1]))


class JointHistory:
    """Joint states by stamp."""

    def __init__(self) -> None:
        self._states: deque[State] = deque()

    def add(self, stamp_ns: int, values: FloatArray) -> None:
        """Keep a state (n,); one that is not finite or not later than the last is ignored."""
        if not np.isfinite(values).all():
            return
        states = self._states
        if states and (stamp_ns <= states[-1][0] or len(values) != len(states[-1][1])):
            if stamp_ns > states[-1][0] - KEPT_NS:
                return
            states.clear()  # the clock was set back
        states.append((stamp_ns, values))
        while stamp_ns - states[0][0] > KEPT_NS:
            states.popleft()

    def at(self, stamp_ns: int) -> FloatArray | None:
        """The values (n,) at a time, or of the nearest state; None: not known."""
        before, after = self._around(stamp_ns)
        nearest = before or after
        if before is not None and after is not None:
            return self.between(stamp_ns)
        if nearest is None or abs(stamp_ns - nearest[0]) > MOST_GAP_NS:
            return None
        return nearest[1]

    def between(self, stamp_ns: int) -> FloatArray | None:
        """The values (n,) at a time, by the two states around it; None: one is missing, or far."""
        before, after = self._around(stamp_ns)
        return None if before is None or after is None else between(before, after, stamp_ns)

    def _around(self, stamp_ns: int) -> tuple[State | None, State | None]:
        """The last state that is not later, and the first that is."""
        before = None
        for state in self._states:
            if state[0] > stamp_ns:
                return before, state
            before = state
        return before, None
