"""A leader that moves by itself, for a second `--leader`: rests 3 s, right for 1 s, left 1 s."""

from __future__ import annotations

import numpy as np

from surg_core.hand.leader_sample import HandRate, LeaderSample

SPEED = 0.01
"""[m/s]"""


class SecondHand:
    """See the module."""

    mapping = "rate"

    def __init__(self) -> None:
        self.name = "second_hand"

    def open(self) -> None:
        """There is no device."""

    def read(self, now: float) -> LeaderSample:
        """Where in its five seconds the hand is."""
        phase = now % 5.0
        speed = 0.0 if phase < 3.0 else SPEED if phase < 4.0 else -SPEED
        return LeaderSample(stamp=now, rate=HandRate(np.array([speed, 0.0, 0.0])))

    def close(self) -> None:
        """There is no device."""
