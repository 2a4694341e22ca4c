"""A mailbox for commands: the receiver puts, the tick takes, and neither takes a lock.

A lock would delay commands. A free-running simulator that is behind ticks without a pause and
holds its lock almost all the time; receivers would queue for it, and the arm would follow commands
that are half a second old.

A simulator that the machine serves late makes its missed ticks all at once. A robot would have
obeyed the commands that arrived meanwhile one after the other. So does the simulator: otherwise the
arm would repeat the newest one for all of these ticks, and leave its path.
"""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")

_OLDEST = 8
"""[ticks] A command that waited longer is skipped: a loop with much delay shakes the arm."""


class CommandBox(Generic[T]):
    """Holds the newest commands. One thread may put while another takes."""

    def __init__(self) -> None:
        self._waiting: deque[T] = deque(maxlen=_OLDEST + 1)

    def put(self, value: T) -> None:
        """Add a command behind the ones that were not taken."""
        self._waiting.append(value)

    def take(self, behind: int = 0) -> T | None:
        """Remove the oldest command and return it; None if there is none.

        Args:
            behind: Ticks that are already due after this one. At most as many commands stay for
                them, and at most 8; older ones are skipped.
        """
        taken: T | None = None
        try:
            taken = self._waiting.popleft()
            while len(self._waiting) > behind:
                taken = self._waiting.popleft()
        except IndexError:
            pass
        return taken
