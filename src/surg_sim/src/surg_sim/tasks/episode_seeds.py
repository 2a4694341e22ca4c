"""Which seeds may be learned from, which may be looked at, and which are kept for the judgement.

The three ranges are disjoint and stand here only. Demonstrations have ``TRAINING`` seeds; a
threshold, a gain or the size of a network is chosen with ``TUNING`` seeds; a figure in the
documentation is of ``TEST`` seeds.
"""

from __future__ import annotations

import functools

TRAINING = range(10_000, 10_700)
"""Seeds to train with: demonstrations are theirs."""
TUNING = range(10_700, 11_000)
"""Seeds to choose with."""
TEST = range(20_000, 21_000)
"""Seeds to judge with; a figure over n episodes takes the first n."""


def _first(seeds: range, name: str, n: int) -> range:
    if not 0 < n <= len(seeds):
        raise ValueError(f"{n} {name} seeds: 1 to {len(seeds)} are there")
    return seeds[:n]


training_seeds = functools.partial(_first, TRAINING, "training")
"""The first n training seeds; a ValueError if there are not so many."""
test_seeds = functools.partial(_first, TEST, "test")
"""The first n test seeds, likewise."""
