"""Log dimensionless jerk in two forms.

``ldlj``: S. Balasubramanian et al., "On the analysis of movement smoothness", J. NeuroEng. Rehabil.
12:112, 2015. ``ldlj_displacement``: our reading of the paper's figures (docs/guide/evaluation.md).
"""

from __future__ import annotations

import math

import numpy as np

from surg_recording.metrics._types import ArrayLike, finite, positive


def ldlj(velocity: ArrayLike, fs: float) -> float:
    """Log dimensionless jerk from velocity: more negative when less smooth.

    −ln( T³/v_peak² · Σ ‖Δ²v/Δt²‖² Δt ) with T = N Δt. ``fs`` [Hz] cancels out: only the number of
    samples and the shape of the motion count.

    Args:
        velocity: (N,) the scalar speed form, or (N, D) the vector form: jerk vector, peak of the
            speed ‖v‖.
        fs: Sampling rate [Hz].

    Returns:
        NaN without motion, without jerk or with fewer than 3 samples.

    Raises:
        ValueError: A wrong shape, a non-finite value, or fs not positive.
    """
    v = finite(velocity, "ldlj: velocity")
    if v.ndim not in (1, 2):
        raise ValueError(f"ldlj: velocity has shape {v.shape}, must be (N,) or (N, D)")
    positive(fs, "ldlj: fs")
    if len(v) < 3:
        return math.nan
    v = v.reshape(len(v), -1)
    peak = float(np.max(np.linalg.norm(v, axis=1)))
    if peak == 0.0:
        return math.nan
    # In units of the sampling step and the peak speed, so that nothing over- or underflows.
    jerk = np.diff(v / peak, n=2, axis=0)
    total = float(len(v)) ** 3 * float(np.sum(jerk**2))
    return -math.log(total) if total > 0.0 else math.nan


def ldlj_displacement(position: ArrayLike, fs: float) -> float:
    """Log dimensionless jerk over the peak displacement, the variant behind the paper's figures.

    −ln( T⁵/A² · Σ ‖Δ³p/Δt³‖² Δt ), A the largest distance from the first sample, T = N Δt. Another
    metric than ``ldlj``: never show the two in one figure.

    Args:
        position: (N, D) positions [m].
        fs: Sampling rate [Hz].

    Returns:
        NaN without motion, without jerk or with fewer than 4 samples.

    Raises:
        ValueError: A wrong shape, a non-finite value, or fs not positive.
    """
    p = finite(position, "ldlj_displacement: position")
    if p.ndim != 2:
        raise ValueError(f"ldlj_displacement: position has shape {p.shape}, must be (N, D)")
    positive(fs, "ldlj_displacement: fs")
    if len(p) < 4:
        return math.nan
    amplitude = float(np.max(np.linalg.norm(p - p[0], axis=1)))
    if amplitude == 0.0:
        return math.nan
    jerk = np.diff((p - p[0]) / amplitude, n=3, axis=0)
    total = float(len(p)) ** 5 * float(np.sum(jerk**2))
    return -math.log(total) if total > 0.0 else math.nan
