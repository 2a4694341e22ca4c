"""The robot's time on our clock.

A state arrives some time after the robot took it; the least delay of the last two seconds stands
for the constant part. The window is short because two clocks need not run alike: with 100 ppm
between them it is wrong by 0.2 ms at most, with 5 % by 100 ms.
"""

from __future__ import annotations

import math
from collections import deque

WINDOW = 2.0
"""[s]"""
REBOOT = 0.001
"""[s] A robot whose clock goes back further than this was restarted."""


class RobotClock:
    """Maps the robot's time to ours by a sliding minimum of arrival less robot's time.

    ``known_for`` is how long states have come since the first one or the last restart, on our
    clock [s].

    Args:
        window: In which the least delay is looked for [s]. Where states come as datagrams and are
            never buffered, a short one follows a clock that runs slow, such as a simulator's.
    """

    def __init__(self, window: float = WINDOW) -> None:
        self._window = window
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next state is the first one."""
        self.known_for = 0.0
        self._first = math.nan
        self._last = -math.inf
        self._least: deque[tuple[float, float]] = deque()  # arrivals with increasing offsets

    def restarted(self, robot_time: float) -> bool:
        """Whether this time means that the robot was restarted: it went back, or is no number."""
        return not robot_time >= self._last - REBOOT

    def arrived(self, robot_time: float, now: float) -> float:
        """Take the arrival of a state; returns when the robot took it, on our clock [s].

        Args:
            robot_time: Of the state, finite, on the robot's clock [s].
            now: Of its arrival, on our clock [s]; never decreases.
        """
        if self.restarted(robot_time):
            self.reset()
        if math.isnan(self._first):
            self._first = now
        self.known_for = now - self._first
        self._last = robot_time
        offset = now - robot_time
        while self._least and self._least[-1][1] >= offset:
            self._least.pop()
        self._least.append((now, offset))
        while self._least[0][0] < now - self._window:
            self._least.popleft()
        return robot_time + self._least[0][1]
