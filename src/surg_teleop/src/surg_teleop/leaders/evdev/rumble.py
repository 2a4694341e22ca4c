"""The force at the tip as the rumble of a gamepad. Values in, values out: no device, no clock."""

from __future__ import annotations

import math
from dataclasses import dataclass

PERIOD = 0.020
"""[s] Between two pieces of rumble; each lasts longer, and ends by itself in the device."""
LONGEST = 0.045
"""[s] What is felt ends so long after its force came."""
SILENT = 0.020
"""[s] Age at which a force is not known any more."""
LEAST = 0.05
"""Share of the full strength below which nothing is felt."""


@dataclass(frozen=True)
class Piece:
    """What the motors shall do: a strength from 0 to 1 for so long [s]; strength 0: stop now."""

    strength: float
    seconds: float


class Rumble:
    """Turns the newest force into pieces of rumble.

    Args:
        full: Force at which the motors run at full strength [N].
    """

    def __init__(self, full: float) -> None:
        self._full = full
        self._force = 0.0
        self._came = -math.inf
        self._next = -math.inf
        self._runs = False

    def take(self, force: float, allowed: bool, now: float) -> None:
        """A force at the tip [N], and whether it may be felt; now [s] runs steadily."""
        known = allowed and math.isfinite(force)
        self._force = abs(force) if known else 0.0
        self._came = now if known else -math.inf

    def step(self, now: float) -> Piece | None:
        """What to tell the motors now; None: nothing new."""
        age = now - self._came
        strength = min(self._force / self._full, 1.0)
        if not 0.0 <= age <= SILENT or strength < LEAST:
            stop, self._runs = self._runs, False
            self._next = -math.inf
            return Piece(0.0, 0.0) if stop else None
        if now < self._next:
            return None
        self._next, self._runs = now + PERIOD, True
        return Piece(strength, LONGEST - age)
