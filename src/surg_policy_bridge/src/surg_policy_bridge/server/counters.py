"""Statistics for the status topic."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

KEPT = 4096
"""Number of values kept."""


@dataclass
class Spread:
    """The newest values of a duration [ns]."""

    values: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT))

    def add(self, value: int) -> None:
        """Add a value."""
        self.values.append(value)

    @property
    def percentiles(self) -> tuple[float, float]:
        """Median and 99th percentile [s]; NaN before the first."""
        if not self.values:
            return math.nan, math.nan
        p50, p99 = np.percentile(np.array(self.values), [50, 99])
        return 1e-9 * float(p50), 1e-9 * float(p99)


@dataclass
class Counters:
    """Counts since the start of the node."""

    accepted: int = 0  # steps relayed to the arms
    clipped: int = 0  # of them, those that a rule has shortened
    rejected: Counter[str] = field(default_factory=Counter)  # rejected steps, by rule
    late: int = 0  # steps that arrived after their time (docs/reference/policies.md)
    # steps whose observation was too old when they were due, and chunks that answered an
    # observation older than the newest one answered
    stale: int = 0
    empty: int = 0  # grid times without a step
    waited: int = 0  # grid times without an answer in time (lock-step)
    messages: int = 0
    malformed: Counter[str] = field(default_factory=Counter)  # by the codec's code
    flooded: int = 0  # messages above the rate limit, dropped undecoded
    strangers: int = 0  # messages without a session, or of another one
    sessions: int = 0
    obs_age: Spread = field(default_factory=Spread)  # of observations, when a step is relayed
    round_trip: Spread = field(default_factory=Spread)  # from sending an observation to the answer
