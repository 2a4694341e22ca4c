"""How long messages were held up on their way, told by their stamps, with no clock in common.

Pure: time is an argument. A network that stalls delivers what was sent meanwhile all at once, and
every old pose would look new. The stamps say how far apart the messages were sent; the quickest one
of the last seconds stands for a delay of zero.
"""

from __future__ import annotations

import math


class Lateness:
    """How much longer than the quickest message each one was under way.

    The two clocks are steady but have nothing in common: the smallest difference between receipt
    and sending, over the last one to two windows, stands for a delay of zero.

    Args:
        window: Over which the quickest message is looked for: clocks drift [s].
    """

    def __init__(self, window: float = 10.0) -> None:
        self._window = window
        self._best = self._previous = math.inf
        self._until = -math.inf

    def add(self, sent: float, received: float) -> float:
        """Take a message in.

        Args:
            sent: On the sender's clock [s].
            received: On ours [s].

        Returns:
            Its delay above that of the quickest [s].
        """
        if received > self._until:
            self._previous, self._best = self._best, math.inf
            self._until = received + self._window
        difference = received - sent
        self._best = min(self._best, difference)
        return difference - min(self._best, self._previous)


class Arrivals:
    """When the messages of one topic would have come, had nothing held them up.

    A stamp that stands still says nothing about the way, and one that goes back is a clock that was
    set: neither makes a message late (F09). A way that has become longer for good is taken as it is
    after one to two windows.
    """

    WINDOW = 2.0
    """[s]"""

    def __init__(self) -> None:
        self._newest = -math.inf
        self._lateness = Lateness(self.WINDOW)

    def of(self, stamp: float, now: float) -> float:
        """Take a message in.

        Args:
            stamp: Of the message, on its sender's clock [s].
            now: Its receipt on the steady clock [s].

        Returns:
            Not after now, on the same clock [s].
        """
        if stamp == self._newest:
            return now
        if stamp < self._newest:
            self._lateness = Lateness(self.WINDOW)
        self._newest = stamp
        return now - self._lateness.add(stamp, now)
