"""Which seeds may be looked at while something is tuned, and which are kept for the judgement.

The ranges are disjoint and stand here only. A figure in the documentation is of ``TEST`` seeds; a
threshold, a gain or a policy is chosen with ``TUNING`` seeds.
"""

from __future__ import annotations

TUNING = range(10_000, 11_000)
"""Seeds to tune and to train with."""
TEST = range(20_000, 21_000)
"""Seeds to judge with; a figure over n episodes takes the first n."""


def test_seeds(n: int) -> range:
    """The first n test seeds.

    Raises:
        ValueError: There are not so many.
    """
    if not 0 < n <= len(TEST):
        raise ValueError(f"{n} test seeds: 1 to {len(TEST)} are there")
    return TEST[:n]
