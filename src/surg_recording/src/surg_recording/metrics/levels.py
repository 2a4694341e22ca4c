"""Percentiles of values with gaps."""

from __future__ import annotations

import math

import numpy as np

from surg_recording.metrics._types import ArrayLike


def percentiles(values: ArrayLike, *levels: float) -> list[float]:
    """Percentiles (0–100, linear interpolation) of the finite values; NaN without any."""
    v = np.asarray(values, dtype=float)
    v = v[np.isfinite(v)]
    if v.size == 0:
        return [math.nan] * len(levels)
    return [float(x) for x in np.percentile(v, levels)]
