"""Which seeds may be learned from, which may be looked at, and which are kept for the judgement.

The three ranges are disjoint and stand here only. Demonstrations have ``TRAINING`` seeds; a
threshold, a gain or the size of a network is chosen with ``TUNING`` seeds; a figure in the
documentation is of ``TEST`` seeds.
"""

from __future__ import annotations

TRAINING = range(10_000, 10_700)
"""Seeds to train with: demonstrations are theirs."""
TUNING = range(10_700, 11_000)
"""Seeds to choose with."""
TEST = range(20_000, 21_000)
"""Seeds to judge with; a figure over n episodes takes the first n."""


def training_seeds(n: int) -> range:
    """The first n training seeds.

    Raises:
        ValueError: There are not so many.
    """
    return _first(TRAINING, n, "training")


def tuning_seeds(n: int) -> range:
    """The first n tuning seeds.

    Raises:
        ValueError: There are not so many.
    """
    return _first(TUNING, n, "tuning")


def test_seeds(n: int) -> range:
    """The first n test seeds.

    Raises:
        ValueError: There are not so many.
    """
    return _first(TEST, n, "test")


def _first(whole: range, n: int, name: str) -> range:
    if not 0 < n <= len(whole):
        raise ValueError(f"{n} {name} seeds: 1 to {len(whole)} are there")
    return whole[:n]
