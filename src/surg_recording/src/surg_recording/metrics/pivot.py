"""Distance between pivot and shaft."""

from __future__ import annotations

import numpy as np

from surg_recording.metrics._types import Array, ArrayLike, rows3


def rcm_deviation(p_BShaft: ArrayLike, s_B: ArrayLike, p_BRcm: ArrayLike) -> Array:
    """Distance from the pivot to the infinite shaft line, per sample.

    Args:
        p_BShaft: (N, 3) any point of the shaft [m].
        s_B: (N, 3) direction of the shaft, of any length but zero.
        p_BRcm: (N, 3) or (3,) the pivot [m].

    Returns:
        (N,) distances [m]; NaN where the direction has no length or a value is not finite.

    Raises:
        ValueError: The shapes differ.
    """
    point, axis = rows3(p_BShaft, "p_BShaft"), rows3(s_B, "s_B")
    pivot = np.asarray(p_BRcm, dtype=float)
    pivot = np.broadcast_to(pivot, point.shape) if pivot.shape == (3,) else rows3(pivot, "p_BRcm")
    if not point.shape == axis.shape == pivot.shape:
        raise ValueError(
            f"rcm_deviation: shapes {point.shape}, {axis.shape} and {pivot.shape} differ;"
            " all must be (N, 3)"
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        s = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        return np.asarray(np.linalg.norm(np.cross(pivot - point, s), axis=1))
