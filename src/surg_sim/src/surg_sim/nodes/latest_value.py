"""A mailbox for one value: the receiver puts, the tick takes, and neither takes a lock.

A lock would delay commands. A free-running simulator that is behind ticks without a pause and
holds its lock almost all the time; receivers would queue for it, and the arm would follow commands
that are half a second old.
"""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class LatestValue(Generic[T]):
    """Holds the most recent value. One thread may put while another takes."""

    def __init__(self) -> None:
        self._slot: deque[T] = deque(maxlen=1)

    def put(self, value: T) -> None:
        """Store a value; it replaces one that was not taken."""
        self._slot.append(value)

    def take(self) -> T | None:
        """Remove and return the value; None if there is none."""
        try:
            return self._slot.pop()
        except IndexError:
            return None
