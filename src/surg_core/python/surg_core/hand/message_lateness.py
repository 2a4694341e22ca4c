"""Estimates how long messages were delayed on their way, from their stamps alone.

A network that stalls delivers its backlog at once, and old poses would look new. Sender and
receiver have no common clock; the fastest message of the last seconds stands for zero delay. Pure:
time is an argument.
"""

from __future__ import annotations

import math

WINDOW = 2.0
"""[s] Window of a topic's lateness."""


class Lateness:
    """Delay of every message above that of the fastest one.

    The smallest difference between receipt and sending, over the last one to two windows, stands
    for zero delay.

    Args:
        window: Window of the minimum [s]; bounded because clocks drift.
    """

    def __init__(self, window: float = 10.0) -> None:
        self._window = window
        self._best = self._previous = math.inf
        self._until = -math.inf

    def add(self, sent: float, received: float) -> float:
        """Delay of a message above that of the fastest, from both ends' clocks [s]."""
        if received > self._until:
            self._previous, self._best = self._best, math.inf
            self._until = received + self._window
        difference = received - sent
        self._best = min(self._best, difference)
        return difference - min(self._best, self._previous)


class Arrivals:
    """Receipt times of one topic, corrected for the delay.

    Repeated stamps carry no information, and a stamp that goes back means that the sender's clock
    was set: neither makes a message late (F09). A lasting increase of the delay is accepted after
    one to two windows.
    """

    def __init__(self) -> None:
        self._newest = -math.inf
        self._lateness = Lateness(WINDOW)

    def of(self, stamp: float, now: float) -> float:
        """When a message, received now, would have arrived without delay [s]; never after now."""
        if stamp == self._newest:
            return now
        if stamp < self._newest:
            self._lateness = Lateness(WINDOW)
        self._newest = stamp
        return now - self._lateness.add(stamp, now)
