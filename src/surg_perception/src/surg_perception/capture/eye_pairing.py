"""Pairs of pictures from two devices, by their stamps."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np

KEPT = 4
"""Pictures of an eye that wait for the other eye."""
UNPAIRED = 5
"""Pictures of each eye in a row without a pair, from which the devices are not synchronised."""
LARGEST_SPREAD = 0.25
"""Share of the period; a larger spread of the offset means that the devices run freely."""
NOT_SYNCHRONISED = (
    "the two devices are not synchronised: use genlock, or one grabber that takes both eyes"
)


class EyePair(NamedTuple):
    """Two pictures with one stamp, the mean of both [ns]."""

    stamp_ns: int
    left: Any
    right: Any


class OffsetReport(NamedTuple):
    """Stamps of the right eye minus those of the left eye [ns]."""

    pairs: int
    offset_ns: float  # median
    spread_ns: float  # 5th to 95th percentile
    problem: str  # empty: the devices are synchronised


class EyePairer:
    """Pairs the nearest stamps within half a period.

    Args:
        period_ns: Of the pictures; 0: it is estimated from the stamps.
    """

    def __init__(self, period_ns: int = 0) -> None:
        self._stated = period_ns
        self._waiting: tuple[deque[tuple[int, Any]], ...] = (deque(maxlen=KEPT), deque(maxlen=KEPT))
        self._newest = [0, 0]
        self._intervals: tuple[deque[int], ...] = (deque(maxlen=30), deque(maxlen=30))
        self._offsets: list[int] = []
        self._alone = [0, 0]

    @property
    def period_ns(self) -> float:
        """Stated, or the median distance of stamps; 0: not known yet."""
        if self._stated:
            return float(self._stated)
        medians = [float(np.median(list(each))) for each in self._intervals if each]
        return min(medians, default=0.0)

    def add(self, eye: int, stamp_ns: int, picture: Any) -> EyePair | None:
        """The pair that this picture completes.

        Args:
            eye: 0 left, 1 right.
            stamp_ns: Of the picture; it may jump where a clock is set.
            picture: Anything.
        """
        if 0 < self._newest[eye] < stamp_ns:
            self._intervals[eye].append(stamp_ns - self._newest[eye])
        self._newest[eye] = stamp_ns
        mine, others = self._waiting[eye], self._waiting[1 - eye]
        nearest = min(others, key=lambda other: abs(other[0] - stamp_ns), default=None)
        period = self.period_ns
        if nearest is None or not period or abs(nearest[0] - stamp_ns) > 0.5 * period:
            self._alone[eye] += 1
            mine.append((stamp_ns, picture))
            return None
        while others.popleft()[0] != nearest[0]:
            pass  # older ones find no partner any more
        mine.clear()
        self._alone = [0, 0]
        left, right = ((stamp_ns, picture), nearest)[:: 1 if eye == 0 else -1]
        self._offsets.append(right[0] - left[0])
        return EyePair((left[0] + right[0]) // 2, left[1], right[1])

    def report(self) -> OffsetReport:
        """Offset and spread since the last report."""
        offsets, self._offsets = np.asarray(self._offsets, float), []
        alone = min(self._alone) >= UNPAIRED
        if not offsets.size:
            return OffsetReport(0, 0.0, 0.0, NOT_SYNCHRONISED if alone else "")
        low, median, high = np.percentile(offsets, (5, 50, 95))
        free = high - low > LARGEST_SPREAD * self.period_ns
        problem = NOT_SYNCHRONISED if alone or free else ""
        return OffsetReport(offsets.size, float(median), float(high - low), problem)
