"""Types of all metrics, and checks of their arguments."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ArrayLike = npt.ArrayLike


def rows3(value: ArrayLike, name: str) -> Array:
    """The value as an (N, 3) array, or a ValueError that names it."""
    array = np.asarray(value, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} has shape {array.shape}, must be (N, 3)")
    return array


def finite(value: ArrayLike, name: str) -> Array:
    """The value as finite numbers, or a ValueError with its name and the first wrong index."""
    array = np.asarray(value, dtype=float)
    if not np.all(np.isfinite(array)):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} is not finite at index {where}")
    return array


def positive(value: float, name: str) -> float:
    """The value, or a ValueError that names it."""
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} is {value}, must be > 0")
    return value
