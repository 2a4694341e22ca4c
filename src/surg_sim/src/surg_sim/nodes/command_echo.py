"""What a command answers: told by the stamp that its sender has copied from the instrument.

A network that stalls delivers what was sent meanwhile all at once. A stamp is looked up among those
that this side has given its own states, and never read as a time: no clock in common is needed, and
one that is wrong or set decides nothing. An arm's controller does the same (surg_control's echoes).
"""

from __future__ import annotations

LATE = 50
"""[ticks] A command that answers an older state is late: 0.1 s, the silence that stops an arm."""
KEPT = 2048
"""[ticks] Stamps that are remembered: longer than a role keeps what is not acknowledged (3 s)."""
TICK_NS = 2_000_000
"""[ns] What a sender adds that means the tick after the state it has seen."""


class Echoes:
    """Remembers the stamps of the newest states. One thread remembers; any may ask."""

    def __init__(self) -> None:
        self._tick = 0
        self._ticks: dict[int, int] = {}  # in the order of ticks

    def remember(self, stamp_ns: int) -> None:
        """A state with this stamp has been sent; it is a tick after the one before."""
        self._tick += 1
        self._ticks.pop(stamp_ns, None)  # a clock that was set back may give one again
        self._ticks[stamp_ns] = self._tick
        if len(self._ticks) > KEPT:
            del self._ticks[next(iter(self._ticks))]

    def late(self, stamp_ns: int) -> bool:
        """Whether a command answers a state from more than `LATE` ticks ago.

        Args:
            stamp_ns: Its stamp. One that is of no state of these, or 0, is of some other clock: not
                late.
        """
        own = self._ticks.get(stamp_ns, self._ticks.get(stamp_ns - TICK_NS, self._tick))
        return self._tick - own > LATE
