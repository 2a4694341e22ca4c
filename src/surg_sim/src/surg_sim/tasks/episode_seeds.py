"""Which seeds may be learned from, which may be looked at, and which are kept for the judgement.

The ranges are disjoint and stand here only. Demonstrations have ``TRAINING`` seeds; a
threshold, a gain or the size of a network is chosen with ``TUNING`` seeds; a figure in the
documentation is of ``TEST`` seeds. Who judges others keeps a phrase to himself, which draws
``HELD_OUT`` seeds.
"""

from __future__ import annotations

import functools
import hashlib

TRAINING = range(10_000, 10_700)
"""Seeds to train with: demonstrations are theirs."""
TUNING = range(10_700, 11_000)
"""Seeds to choose with."""
TEST = range(20_000, 21_000)
"""Seeds to judge with; a figure over n episodes takes the first n."""

HELD_OUT = range(1 << 20, 1 << 31)
"""Seeds that a phrase draws from."""


def held_out_seeds(phrase: str, n: int) -> list[int]:
    """The first n seeds of a phrase: without it nobody can train or choose with them."""
    found = dict.fromkeys(_drawn(phrase, i) for i in range(2 * n))
    return list(found)[:n]


def _drawn(phrase: str, place: int) -> int:
    digest = hashlib.sha256(f"{place} {phrase}".encode()).digest()
    return HELD_OUT[int.from_bytes(digest[:8], "big") % len(HELD_OUT)]


def _first(seeds: range, name: str, n: int) -> range:
    if not 0 < n <= len(seeds):
        raise ValueError(f"{n} {name} seeds: 1 to {len(seeds)} are there")
    return seeds[:n]


training_seeds = functools.partial(_first, TRAINING, "training")
"""The first n training seeds; a ValueError if there are not so many."""
test_seeds = functools.partial(_first, TEST, "test")
"""The first n test seeds, likewise."""
