"""Intervals of a rate and of a median, and the spread of a sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from surg_core.wilson import wilson_interval


def success_rate(successes: Sequence[bool | None]) -> dict[str, float | int]:
    """Number of trials and successes, and the ends of the 95 % interval.

    None, of a trial without a verdict, does not count.
    """
    judged = [success for success in successes if success is not None]
    k, n = sum(judged), len(judged)
    low, high = wilson_interval(k, n) if n else (0.0, 1.0)
    return {"n": n, "k": k, "low": low, "high": high}


def median_interval(numbers: Sequence[float]) -> tuple[float, float] | None:
    """Interval that holds the distribution's median with at least 95 %; None of fewer than 6.

    The ends are two of the numbers, so nothing is assumed about the distribution: with X_(r) the
    r-th smallest of n, P(X_(r) ≤ median ≤ X_(n+1−r)) ≥ 1 − 2 P(B ≤ r − 1) with B binomial(n, ½).
    The largest r is taken that keeps this at or above 95 %.
    """
    ordered, n = sorted(numbers), len(numbers)
    rank = int(stats.binom.ppf(0.025, n, 0.5))
    return (ordered[rank - 1], ordered[n - rank]) if rank > 0 else None


def spread(numbers: Sequence[float]) -> dict[str, Any]:
    """Count, extremes, quartiles and median of finite numbers, with the median's 95 % interval.

    Returns:
        ``n``, ``min``, ``median``, ``max``, ``quartiles`` [first, third] (by linear interpolation),
        ``iqr`` (their distance) and ``interval``; all but ``n`` None where they do not exist.
    """
    if not len(numbers):
        names = ("min", "median", "max", "quartiles", "iqr", "interval")
        return {"n": 0, **dict.fromkeys(names)}
    first, median, third = (float(x) for x in np.percentile(numbers, (25, 50, 75)))
    interval = median_interval(numbers)
    return {
        "n": len(numbers),
        "min": float(min(numbers)),
        "median": median,
        "max": float(max(numbers)),
        "quartiles": [first, third],
        "iqr": third - first,
        "interval": None if interval is None else list(interval),
    }
