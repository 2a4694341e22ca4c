"""From clock patterns in pictures to the time from glass to stamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_READ = 60
LEAST_SHARE = 0.2
"""Of the pictures, that hold a readable pattern: the others were exposed while the screen changed,
or the pattern is out of the picture."""
LARGEST_SPREAD_MS = 60.0
"""Two pictures of a screen at 60 Hz and one of a camera at 30 Hz. More means that clock or load
disturb the measurement."""
LARGEST_MS = 1000.0


class LatencyError(ValueError):
    """Why the pictures do not tell the latency, and what to do."""


@dataclass(frozen=True)
class Latency:
    """Time from glass to stamp.

    Attributes:
        seconds: Median.
        spread: 5th to 95th percentile [s].
        read: Pictures with a readable pattern.
        seen: All pictures.
    """

    seconds: float
    spread: float
    read: int
    seen: int


def of_ages(ages_ms: list[float | None], subtracted: float = 0.0) -> Latency:
    """The latency of a series of pictures.

    Args:
        ages_ms: From the time that a picture shows to its stamp; None: unreadable.
        subtracted: What the stamps lack already [s].

    Raises:
        LatencyError: Too few are readable, they disagree, or the clocks do.
    """
    read = np.array([age for age in ages_ms if age is not None])
    if len(read) < LEAST_READ or len(read) < LEAST_SHARE * len(ages_ms):
        raise LatencyError(
            f"{len(read)} of {len(ages_ms)} pictures hold a readable pattern; {LEAST_READ} and "
            f"{LEAST_SHARE:.0%} are needed. Bring the whole frame into the left picture, sharp and "
            "without reflections; shorten the exposure"
        )
    low, median, high = np.percentile(read, (5, 50, 95)) + 1e3 * subtracted
    if not 0.0 <= median <= LARGEST_MS:
        raise LatencyError(
            f"the pictures are {median:.1f} ms older than their stamps; 0 to {LARGEST_MS:.0f} is "
            "possible. Show the pattern on this machine, or synchronise the clocks (./surg ptp)"
        )
    if high - low > LARGEST_SPREAD_MS:
        raise LatencyError(
            f"the latency spreads over {high - low:.1f} ms (5 to 95 %); at most "
            f"{LARGEST_SPREAD_MS:.0f} is usable. End other programs, and repeat"
        )
    return Latency(1e-3 * float(median), 1e-3 * float(high - low), len(read), len(ages_ms))
