"""Log dimensionless jerk in two forms.

``ldlj``: S. Balasubramanian et al., "On the analysis of movement smoothness", J. NeuroEng. Rehabil.
12:112, 2015. ``ldlj_displacement``: our reading of the paper's figures (docs/guide/evaluation.md).
"""

from __future__ import annotations

import math

import numpy as np

from surg_recording.metrics._types import Array, ArrayLike, finite, positive


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
    return _log_jerk(v[:, None] if v.ndim == 1 else v, order=2)


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
    return _log_jerk(p - p[:1], order=3)


def _log_jerk(x: Array, order: int) -> float:
    """−ln( N^(2·order − 1) Σ ‖Δ^order x‖² ) of (N, D) values in units of their largest norm.

    In units of the sampling step and that norm, so that nothing over- or underflows.
    """
    peak = np.max(np.linalg.norm(x, axis=1), initial=0.0)
    if len(x) <= order or peak == 0.0:
        return math.nan
    total = float(len(x)) ** (2 * order - 1) * float(
        np.sum(np.diff(x / peak, n=order, axis=0) ** 2)
    )
    return -math.log(total) if total > 0.0 else math.nan
