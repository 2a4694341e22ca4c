"""Wilson's score interval of a proportion (Wilson 1927)."""

from __future__ import annotations

import math

Z_95 = 1.959963984540054
"""Two-sided 95 % quantile of the normal distribution."""


def wilson_interval(successes: int, trials: int, z: float = Z_95) -> tuple[float, float]:
    """Interval of the success rate behind a few trials; it also holds near 0 and 1.

    Args:
        successes: Number of successes.
        trials: Number of trials.
        z: Quantile of the normal distribution.

    Returns:
        Lower and upper end in [0, 1]; (0, 1) without trials.

    Raises:
        ValueError: successes is not within 0 … trials.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes of {trials} trials")
    if trials == 0:
        return 0.0, 1.0
    share = successes / trials
    centre = share + z * z / (2 * trials)
    half = z * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    low, high = (centre - half) / scale, (centre + half) / scale
    # At the ends the formula gives 0 and 1 exactly; floating point almost does.
    return (0.0 if successes == 0 else low), (1.0 if successes == trials else high)
