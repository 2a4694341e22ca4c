"""Detects commands that swing: a tip that is sent to and fro without a rest.

A policy that counts its steps from a place that lags or runs ahead overshoots at every turn. People
and experts turn round, too, but they rest there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from surg_core.contract import SECOND_NS, STEP_NS

TURN = 2e-3
"""[m] Way back along one axis that is a turn."""
REST = 5e-4
"""[m] Distance from where it turned at which a tip still rests there."""
SHARP = 3 * STEP_NS
"""[ns] A turn with a longer rest is on purpose: every task's expert rests for 0.25 s at least."""
TURNS = 3
"""Sharp turns along one axis within `WINDOW` that are a swing; no expert had one in 24."""
WINDOW = 2 * SECOND_NS
"""[ns]"""


class _Axis:
    """One coordinate of a commanded tip."""

    def __init__(self) -> None:
        self._low, self._high = np.inf, -np.inf
        self._way, self._end = 0.0, 0.0
        self._since = self._rested = 0
        self.turns: deque[tuple[int, float]] = deque()

    def take(self, x: float, at: int) -> None:
        """A coordinate [m], commanded at a time [ns]."""
        if self._way == 0.0:
            self._low, self._high = min(self._low, x), max(self._high, x)
            if self._high - self._low > TURN:
                self._way = 1.0 if x == self._high else -1.0
                self._end, self._since, self._rested = x, at, at
            return
        gone = x - self._end
        if gone * self._way > 0.0:
            if abs(gone) > REST:
                self._since = at
            self._end, self._rested = x, at
        elif abs(gone) < REST:
            self._rested = at
        elif abs(gone) > TURN:
            if self._rested - self._since <= SHARP:
                self.turns.append((at, abs(gone)))
            self._end, self._way, self._since, self._rested = x, -self._way, at, at
        while self.turns and at - self.turns[0][0] > WINDOW:
            self.turns.popleft()


class SwingWatch:
    """Reads every step that is sent; ``arms`` are in the order of the action.

    Attributes:
        warning: What was found since `start`, for people; empty: nothing.
    """

    def __init__(self, arms: Sequence[str]) -> None:
        self._arms = tuple(arms)
        self.start()

    def start(self) -> None:
        """An episode begins."""
        self.warning = ""
        self._axes = {(arm, axis): _Axis() for arm in self._arms for axis in "xyz"}

    def take(self, ends: NDArray[np.float64], at: int) -> None:
        """The shafts' ends (arms, 3) [m] that were sent at a time [ns]."""
        for ((arm, name), axis), x in zip(self._axes.items(), ends.ravel(), strict=True):
            axis.take(float(x), at)
            if len(axis.turns) >= TURNS and not self.warning:
                self.warning = (
                    f"the commands swing: {arm} turned round {len(axis.turns)} times in "
                    f"{WINDOW / SECOND_NS:g} s along {name} without a rest; count the steps from "
                    "held_action() or from your own last row, not from a measured place"
                )
