"""Intervals: of the median by its definition and by trial, of a rate in both places it stands."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from surg_recording.metrics.confidence_intervals import median_interval, spread


def test_the_interval_of_the_median_is_the_narrowest_that_holds(full: bool) -> None:
    for n in range(120 if full else 40):
        below = list(itertools.accumulate(math.comb(n, r) for r in range(n + 1)))
        held = [r for r in range(1, n // 2 + 1) if 2 * below[r - 1] <= 0.05 * 2**n]
        expected = (held[-1], n + 1 - held[-1]) if held else None
        assert median_interval(list(range(1, n + 1))) == expected


def test_it_holds_the_median_of_a_skewed_distribution(full: bool) -> None:
    rng, runs = np.random.default_rng(31), 20000 if full else 4000
    drawn = rng.lognormal(sigma=1.5, size=(runs, 10))  # its median is 1
    ends = [median_interval(row) for row in drawn.tolist()]
    held = np.mean([end is not None and end[0] <= 1.0 <= end[1] for end in ends])
    exact = 1 - 2 * stats.binom.cdf(1, 10, 0.5)
    print(f"{held:.4f} of {runs} intervals hold it, {exact:.4f} should")
    assert held == pytest.approx(exact, abs=0.012)


def test_few_numbers_have_no_interval() -> None:
    assert [median_interval([1.0] * n) for n in range(6)] == [None] * 6


def test_a_spread() -> None:
    numbers = [3.0, 1.0, 2.0, 10.0, 4.0, 5.0]
    found = spread(numbers)
    assert found == {
        "n": 6, "min": 1.0, "median": 3.5, "max": 10.0,
        "quartiles": [2.25, 4.75], "iqr": 2.5, "interval": [1.0, 10.0],
    }  # fmt: skip
    assert spread([])["n"] == 0 and spread([])["median"] is None
    assert spread([2.0])["interval"] is None and spread([2.0])["iqr"] == 0.0
