"""What came last, put by whoever receives and taken by the tick, without a lock.

In lock-step a thread of the connection receives, in free-run the tick itself (`polled_node`). In
free-run a simulator that is behind ticks without a pause and holds its lock nearly all the time.
A receiver that wanted the same lock would get it now and then, messages would queue in front of it,
and the arm would obey commands that are half a second old.
"""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """Room for one; one thread may put while another takes."""

    def __init__(self) -> None:
        self._room: deque[T] = deque(maxlen=1)

    def put(self, value: T) -> None:
        """Replaces what nobody has taken."""
        self._room.append(value)

    def take(self) -> T | None:
        """What was put last and has not been taken; None: nothing."""
        try:
            return self._room.pop()
        except IndexError:
            return None
