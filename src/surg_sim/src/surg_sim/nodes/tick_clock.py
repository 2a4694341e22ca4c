"""When the ticks of free-run are due, by a steady clock whose times are arguments."""

from __future__ import annotations

from surg_core.contract import SECOND_NS, TICK, TICK_NS

_LATE = 0.05  # [s] free-run drops its backlog when it is later than this


class TickClock:
    """500 Hz; the stamp of tick k is start + k * 2 ms of wall time.

    Attributes:
        overruns: How often the machine stalled.
        behind: Ticks that are already due after this one.
    """

    def __init__(self) -> None:
        self.overruns = self.behind = 0
        self._deadline, self._start_ns = 0.0, 0

    def begin(self, tick: int, now: float, wall_ns: int) -> None:
        """A tick is there now [s], at a wall time [ns]."""
        self._deadline, self._start_ns = now, wall_ns - tick * TICK_NS

    def stamp_ns(self, tick: int) -> int:
        """Of a tick [ns]."""
        return self._start_ns + tick * TICK_NS

    def next(self, now: float) -> float:
        """How long it is until the next tick [s]; after a stall its backlog is dropped."""
        self._deadline += TICK
        left = self._deadline - now
        self.behind = int(max(-left, 0.0) / TICK)
        if left < -_LATE:  # in time and in stamps
            self.overruns += 1
            self._deadline -= left
            self.behind = 0
            self._start_ns -= int(left * SECOND_NS)
        return left
