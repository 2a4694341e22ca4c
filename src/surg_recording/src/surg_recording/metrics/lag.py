"""Tracking error and lag of an executed path against its input."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import optimize

from surg_recording.metrics._types import Array, ArrayLike, rows3
from surg_recording.metrics.filters import interpolate


@dataclasses.dataclass(frozen=True)
class Tracking:
    """Tracking error after the constant lag is removed."""

    lag: float
    """Delay of the executed path [s]; at this shift the rms error is smallest."""
    rms: float
    """Root of the mean squared distance at that lag [m]."""
    max: float
    """Largest distance at that lag [m]."""
    error: Array
    """(N,) distance at that lag [m]; NaN where the shifted input has no sample."""


MAX_LAG = 0.6
"""Largest lag tried [s]."""

_NO_OVERLAP = 1e12
"""Mean square of paths that cannot be compared: finite, because the search computes with it."""


def tracking(t: ArrayLike, executed: ArrayLike, t_input: ArrayLike, p_input: ArrayLike) -> Tracking:
    """Compare an executed path with its input after removing the lag.

    The lag is the shift, to a fraction of a sample, that minimises the rms distance between
    executed(t) and input(t − lag), within [−0.25, 1] times ``MAX_LAG``.

    Args:
        t: (N,) times of the executed samples [s].
        executed: (N, 3) [m].
        t_input: (M,) increasing times of the input samples [s].
        p_input: (M, 3) [m].

    Raises:
        ValueError: A path has fewer than 2 samples, the shapes differ, or the times do not overlap.
    """
    times, path = np.asarray(t, dtype=float), rows3(executed, "tracking: executed")
    source_t, source = np.asarray(t_input, dtype=float), rows3(p_input, "tracking: p_input")
    if len(times) != len(path) or len(source_t) != len(source):
        raise ValueError("tracking: times and positions differ in length")
    if len(path) < 2 or len(source) < 2:
        raise ValueError("tracking: a path needs at least 2 samples")

    def distance(lag: float) -> Array:
        at = times - lag
        d = np.linalg.norm(path - interpolate(at, source_t, source), axis=1)
        d[(at < source_t[0] - 1e-9) | (at > source_t[-1] + 1e-9)] = np.nan
        return np.asarray(d)

    def mean_square(lag: float) -> float:
        d = distance(lag)
        covered = np.isfinite(d)
        # A lag that leaves less than half of the path covered explains nothing.
        return float(np.mean(d[covered] ** 2)) if covered.mean() >= 0.5 else _NO_OVERLAP

    grid = np.linspace(-MAX_LAG / 4, MAX_LAG, 76)
    values = [mean_square(lag) for lag in grid]
    if min(values) >= _NO_OVERLAP:
        raise ValueError("tracking: input and executed path do not overlap in time")
    best = int(np.argmin(values))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    result = optimize.minimize_scalar(
        mean_square, bounds=(low, high), method="bounded", options={"xatol": 1e-6}
    )
    lag = float(result.x) if result.fun <= values[best] else float(grid[best])
    if mean_square(0.0) <= mean_square(lag):
        lag = 0.0
    error = distance(lag)
    return Tracking(lag, float(np.sqrt(np.nanmean(error**2))), float(np.nanmax(error)), error)
