"""Detects late commands by the state stamp that each command echoes.

A stalled network delivers everything it held at once. A sender copies the stamp of the state it
answers into its command. That stamp is looked up among the stamps of the states sent from here and
never read as a time, so the two machines need no common clock. The arm controller does the same.
"""

from __future__ import annotations

from surg_core.contract import TICK_NS

MAX_AGE = 50
"""Age of the answered state above which a command is late [ticks]: 0.1 s, the stream watchdog."""
HISTORY = 2048
"""Number of stamps kept; longer than the 3 s for which a role keeps unacknowledged messages."""


class CommandEcho:
    """History of the stamps of sent states. One thread records; any thread may ask."""

    def __init__(self) -> None:
        self._tick = 0
        self._ticks: dict[int, int] = {}  # stamp to tick, oldest first

    def record(self, stamp_ns: int) -> None:
        """Add the stamp of the state that was just sent, one tick after the previous one."""
        self._tick += 1
        self._ticks.pop(stamp_ns, None)  # a clock that was set back may repeat a stamp
        self._ticks[stamp_ns] = self._tick
        if len(self._ticks) > HISTORY:
            del self._ticks[next(iter(self._ticks))]

    def is_late(self, stamp_ns: int) -> bool:
        """Whether a command answers a state that is more than ``MAX_AGE`` ticks old.

        A command with an unknown stamp, or 0, belongs to another clock and is not late.
        """
        answered = self._ticks.get(stamp_ns, self._ticks.get(stamp_ns - TICK_NS, self._tick))
        return self._tick - answered > MAX_AGE
