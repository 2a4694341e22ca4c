"""A wall clock that detects when it is set.

Stamps are wall-clock time, and NTP, PTP or a person may set that clock while a recording runs. The
steady clock cannot be set: when the distance between the two jumps, the wall clock has stepped.
Slow corrections (slewing) move the distance a little at a time and are no step.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

CLOCK_STEP = "clock_step"
"""Topic of the event of a step; its text ends with the size: ``… -20000000 ns``."""

STEP_NS = 10_000_000
"""A jump of more than this is a step [ns]."""

FUTURE_NS = 50_000_000
"""A stamp further ahead of its reception than this is in the future [ns]."""

_TRIES = 5


class SteppedClock:
    """Wall time in nanoseconds that reports its steps. May be read from any thread.

    ``on_step`` is called with (step [ns], wall time after it [ns]) by the thread that first reads
    the clock after the step, before any thread gets a later time. It must be quick and must not
    read this clock. ``wall`` and ``steady`` are the clocks [ns].
    """

    def __init__(
        self,
        on_step: Callable[[int, int], None],
        wall: Callable[[], int] = time.time_ns,
        steady: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._on_step, self._wall, self._steady = on_step, wall, steady
        self._lock = threading.Lock()
        self._offset, _ = self._measure()

    def now_ns(self) -> int:
        """Wall time [ns]."""
        wall = self._wall()
        moved = wall - self._steady() - self._offset
        if -STEP_NS < moved < STEP_NS:
            # A reader that was preempted between its two readings must not drag the offset along.
            self._offset += moved // 64
            return wall
        with self._lock:
            offset, wall = self._measure()
            step = offset - self._offset
            if abs(step) >= STEP_NS:
                try:
                    self._on_step(step, wall)
                finally:  # last: no thread gets a later time before the step is reported
                    self._offset = offset
        return wall

    def _measure(self) -> tuple[int, int]:
        """Wall minus steady time and the wall time [ns], as precisely as the scheduler allows."""
        best: tuple[int, int, int] | None = None
        for _ in range(_TRIES):
            before = self._steady()
            wall = self._wall()
            width = self._steady() - before
            if best is None or width < best[0]:
                best = width, wall - before - width // 2, wall
        assert best is not None
        return best[1], best[2]
