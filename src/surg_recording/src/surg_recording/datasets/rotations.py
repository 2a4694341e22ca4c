"""Rotations of whole series, as quaternions x, y, z, w, one per row."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def multiply(a: Array, b: Array) -> Array:
    """Product of quaternions x, y, z, w, row by row, (N, 4): first b, then a."""
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    return np.column_stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )


def turn_back(q_AB: Array, v_A: Array) -> Array:
    """Vectors (N, 3) in the axes of A, in those of B; ``q_AB`` (N, 4) is B's orientation in A."""
    u, w = -q_AB[:, :3], q_AB[:, 3:]
    t = 2.0 * np.cross(u, v_A)
    return v_A + w * t + np.cross(u, t)


def tool_quaternion(s_R: Array, roll: Array) -> Array:
    """Orientation of a tool with shaft axis ``s_R`` (N, 3) and this roll (N,), in the rcm frame.

    R_RTool = minimal rotation (z → s) · rotation (z, roll), see docs/reference/conventions.md.
    """
    x, y, z = s_R.T
    # Minimal rotation: axis z × s, half the angle.
    swing = np.column_stack([-y, x, np.zeros_like(x), 1.0 + z])
    swing /= np.linalg.norm(swing, axis=1, keepdims=True)
    zero = np.zeros_like(roll)
    twist = np.column_stack([zero, zero, np.sin(roll / 2), np.cos(roll / 2)])
    return multiply(swing, twist)
