"""Wilson's score interval: against its definition, published values and its coverage."""

from __future__ import annotations

import math

import numpy as np
import pytest

from surg_core.wilson import Z_95, wilson_interval


def ends_by_definition(k: int, n: int) -> tuple[float, float]:
    """The rates p for which k of n lies exactly z standard errors away, found by bisection.

    The standard error is that of the rate p itself, which is the score test's idea.
    """

    def surprise(p: float) -> float:
        return abs(k / n - p) - Z_95 * math.sqrt(p * (1 - p) / n)

    def root(inside: float, outside: float) -> float:
        for _ in range(200):
            middle = (inside + outside) / 2
            inside, outside = (middle, outside) if surprise(middle) < 0 else (inside, middle)
        return (inside + outside) / 2

    # A rate that is never surprising lies between the ends.
    centre = (k + Z_95**2 / 2) / (n + Z_95**2)
    assert surprise(centre) < 0
    return (root(centre, 0.0) if k else 0.0), (root(centre, 1.0) if k < n else 1.0)


def test_the_interval_is_the_one_of_the_score_test() -> None:
    count = 0
    for n in (1, 2, 5, 10, 37, 100, 1000):
        for k in sorted({0, 1, n // 3, n // 2, n - 1, n}):
            assert wilson_interval(k, n) == pytest.approx(ends_by_definition(k, n), abs=1e-9)
            count += 1
    print(f"{count} intervals")


def test_known_intervals() -> None:
    # Newcombe (1998), table I, method 3, of a paper on intervals for one proportion.
    assert wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson_interval(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert wilson_interval(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson_interval(1, 29) == pytest.approx((0.0061, 0.1718), abs=5e-5)


def test_the_interval_covers_the_rate_nineteen_times_of_twenty() -> None:
    rng = np.random.default_rng(7)
    inside = trial_count = 0
    for rate in (0.5, 0.9, 0.95):
        for k in rng.binomial(100, rate, 2000).tolist():
            low, high = wilson_interval(k, 100)
            inside += low <= rate <= high
            trial_count += 1
    print(f"{inside / trial_count:.4f} of {trial_count} intervals hold the rate")
    assert 0.93 < inside / trial_count < 0.97


def test_intervals_of_nothing_and_of_nonsense() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert wilson_interval(0, 10)[0] == 0.0 and wilson_interval(10, 10)[1] == 1.0
    for k, n in ((3, 2), (-1, 5)):
        with pytest.raises(ValueError, match="trials"):
            wilson_interval(k, n)


def test_success_counts_that_pass_a_bound_of_ninety_percent() -> None:
    assert wilson_interval(95, 100)[0] < 0.90 < wilson_interval(96, 100)[0]
