"""Forward kinematics of Franka arms by the maker's Denavit-Hartenberg parameters.

The emulator must not share code with what it tests: nothing here reads a URDF. FER and FR3 have the
same nominal parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
_UP = math.pi / 2.0
TABLE = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -_UP),
    (0.0, 0.316, _UP),
    (0.0825, 0.0, _UP),
    (-0.0825, 0.384, -_UP),
    (0.0, 0.0, _UP),
    (0.088, 0.0, _UP),
)
"""a [m], d [m], alpha [rad] of each joint (Craig's convention; Franka's FCI documentation)."""
FLANGE = 0.107
"""From the last joint to the flange along its axis [m]."""


def fixed(a: float, d: float, alpha: float) -> Matrix:
    """A joint's transform at angle zero, (4, 4)."""
    ca, sa = math.cos(alpha), math.sin(alpha)
    return np.array(
        [[1.0, 0.0, 0.0, a], [0.0, ca, -sa, -d * sa], [0.0, sa, ca, d * ca], [0.0, 0.0, 0.0, 1.0]]
    )


_FIXED = np.array([fixed(*row) for row in TABLE])
_TO_FLANGE = fixed(0.0, FLANGE, 0.0)


def flange(q: Sequence[float] | Sequence[Sequence[float]]) -> Matrix:
    """Poses of the flange in the base frame, (..., 4, 4).

    Args:
        q: Joint positions [rad], (..., 7).
    """
    angles = np.asarray(q)[..., None]
    c, s = np.cos(angles), np.sin(angles)
    x, y = _FIXED[:, :, 0], _FIXED[:, :, 1]
    links = np.empty((*angles.shape[:-1], 4, 4))
    links[...] = _FIXED
    links[..., 0] = c * x + s * y
    links[..., 1] = c * y - s * x
    pose: Matrix = links[..., 0, :, :]
    for joint in range(1, 7):
        pose = pose @ links[..., joint, :, :]
    return pose @ _TO_FLANGE


def from_columns(values: Sequence[float]) -> Matrix:
    """A pose (4, 4) from the interface's 16 numbers, column by column."""
    return np.array(values).reshape(4, 4).T


def to_columns(pose: Matrix) -> list[float]:
    """The interface's 16 numbers of a pose (4, 4)."""
    columns: list[float] = pose.T.ravel().tolist()
    return columns
