"""Limits of connections that are not pages yet: how many, for how long, how often. No sockets.

On loopback an attacker and the operator have one address. So a newcomer displaces the oldest
connection that only waits, and nobody is locked out by connections that send nothing.
"""

from __future__ import annotations

import enum
from collections import Counter
from dataclasses import dataclass

MAX_OPEN, MAX_PER_ADDRESS = 256, 128
"""Connections in all and from one address, without admitted pages."""
HEADER_WAIT, IDLE_WAIT, SERVICE_WAIT = 2.0, 5.0, 5.0
"""[s] Timeouts of a request's header, of the next request, and of a request until its end."""
REQUEST_RATE, REQUEST_BURST = 400.0, 32
"""[1/s] requests that are answered in the long run, and at once after a pause."""
MAX_PIPELINED = 8
"""Unanswered requests of one connection."""


class Stage(enum.IntEnum):
    """What a connection does, in the order in which it is displaced."""

    WAITING = 0  # no request so far
    IDLE = 1  # between two requests
    SERVING = 2  # its request is being answered


@dataclass(eq=False)
class Entry:
    """One connection."""

    address: str
    since: float  # [s] begin of its stage
    stage: Stage = Stage.WAITING


TIMEOUTS = {
    Stage.WAITING: HEADER_WAIT,
    Stage.IDLE: IDLE_WAIT,
    Stage.SERVING: SERVICE_WAIT,
}


class Connections:
    """All connections that are not pages."""

    def __init__(self) -> None:
        self._entries: dict[Entry, None] = {}

    def __len__(self) -> int:
        """Number of connections."""
        return len(self._entries)

    def __contains__(self, entry: object) -> bool:
        """Whether a connection counts."""
        return entry in self._entries

    def enter(self, address: str, now: float) -> tuple[Entry | None, list[Entry]]:
        """Add a connection; returns it (None: refuse it) and those to be closed for it."""
        victims: list[Entry] = []
        counts = Counter(entry.address for entry in self._entries)
        own = counts[address] >= MAX_PER_ADDRESS
        if own or len(self._entries) >= MAX_OPEN:
            crowd = address if own else counts.most_common(1)[0][0]
            victim = min(
                (entry for entry in self._entries if entry.address == crowd),
                key=lambda entry: (entry.stage, entry.since),
            )
            if victim.stage is Stage.SERVING:
                return None, []
            self.remove(victim)
            victims.append(victim)
        entered = Entry(address, now)
        self._entries[entered] = None
        return entered, victims

    def set_stage(self, entry: Entry, stage: Stage, now: float) -> None:
        """Start a stage and its timeout."""
        entry.stage, entry.since = stage, now

    def remove(self, entry: Entry) -> None:
        """Forget a connection: it has ended, or has become a page."""
        self._entries.pop(entry, None)

    def overdue(self, now: float) -> list[Entry]:
        """Remove and return the connections whose timeout has passed."""
        late = [entry for entry in self._entries if now - entry.since > TIMEOUTS[entry.stage]]
        for entry in late:
            self.remove(entry)
        return late


class Pace:
    """Spreads events in time: the generic cell rate algorithm (ITU-T I.371), a virtual queue."""

    def __init__(self, rate: float, burst: int) -> None:
        self._period, self._depth = 1.0 / rate, (burst - 1) / rate
        self._next = -float("inf")  # [s] theoretical arrival time

    def wait(self, now: float) -> float:
        """Take a place in the queue; returns the time [s] until its turn."""
        start = max(self._next, now)
        self._next = start + self._period
        return max(0.0, start - self._depth - now)
