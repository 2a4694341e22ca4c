"""Rotations and poses as numpy arrays.

Poses ``X_AB`` are ``(4, 4)`` homogeneous float64 arrays: the pose of frame B in frame A.
Quaternions are ``(x, y, z, w)``, as on the wire. Roll, pitch, yaw are those of URDF: turns about
the fixed axes x, y, z, in this order.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def _vector(values: npt.ArrayLike, n: int, name: str) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (n,):
        raise ValueError(f"{name}: shape ({n},) is needed, not {array.shape}")
    return array


def rpy_to_matrix(rpy: npt.ArrayLike) -> FloatArray:
    """Rotation of URDF's ``rpy``: ``Rz(yaw) Ry(pitch) Rx(roll)``.

    Args:
        rpy: ``(3,)`` roll, pitch, yaw [rad].

    Returns:
        ``(3, 3)`` rotation matrix.
    """
    roll, pitch, yaw = _vector(rpy, 3, "rpy")
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def axis_angle_to_matrix(axis: npt.ArrayLike, angle: float) -> FloatArray:
    """Rotation by ``angle`` [rad] about ``axis`` ``(3,)``, which need not be a unit vector.

    Raises:
        ValueError: for an axis of length zero.
    """
    direction = _vector(axis, 3, "axis")
    length = float(np.linalg.norm(direction))
    if not length > 0.0:
        raise ValueError("axis: has length zero")
    x, y, z = direction / length
    # Rodrigues: I + sin(angle) K + (1 - cos(angle)) K^2, with K v = axis x v.
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * (K @ K)


def quaternion_xyzw_to_matrix(quaternion: npt.ArrayLike) -> FloatArray:
    """Rotation matrix ``(3, 3)`` of a quaternion ``(x, y, z, w)``, which is normalised first.

    Raises:
        ValueError: for a quaternion of length zero or one that is not finite.
    """
    q = _vector(quaternion, 4, "quaternion")
    length = float(np.linalg.norm(q))
    if not (length > 0.0 and math.isfinite(length)):
        raise ValueError(f"quaternion: {q.tolist()} cannot be normalised")
    x, y, z, w = (q / length).tolist()  # Python's own numbers: the same bits in a third of the time
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def matrix_to_quaternion_xyzw(R: npt.ArrayLike) -> FloatArray:
    """Unit quaternion ``(x, y, z, w)`` of a rotation matrix, with ``w >= 0``.

    Args:
        R: ``(3, 3)`` rotation matrix.

    Raises:
        ValueError: for another shape or a matrix that is not a rotation (to 1e-6).
    """
    M = np.asarray(R, dtype=np.float64)
    if M.shape != (3, 3):
        raise ValueError(f"R: shape (3, 3) is needed, not {M.shape}")
    deviation = float(np.abs(M @ M.T - np.eye(3)).max())
    if not (deviation < 1e-6 and float(np.linalg.det(M)) > 0.0):
        raise ValueError(f"R: not a rotation matrix (R R^T is {deviation:.3g} from the identity)")
    # Shepperd's method: the squares of all four components, then divide by the largest one, which
    # is never small.
    squares = 0.25 * np.array(
        [
            1 + M[0, 0] - M[1, 1] - M[2, 2],
            1 - M[0, 0] + M[1, 1] - M[2, 2],
            1 - M[0, 0] - M[1, 1] + M[2, 2],
            1 + M[0, 0] + M[1, 1] + M[2, 2],
        ]
    )
    # products[i, k] = 4 q_i q_k off the diagonal.
    products = np.zeros((4, 4))
    products[0, 1] = products[1, 0] = M[0, 1] + M[1, 0]
    products[0, 2] = products[2, 0] = M[0, 2] + M[2, 0]
    products[1, 2] = products[2, 1] = M[1, 2] + M[2, 1]
    products[0, 3] = products[3, 0] = M[2, 1] - M[1, 2]
    products[1, 3] = products[3, 1] = M[0, 2] - M[2, 0]
    products[2, 3] = products[3, 2] = M[1, 0] - M[0, 1]
    largest = int(np.argmax(squares))
    row = 0.25 * products[largest]
    row[largest] = squares[largest]
    q: FloatArray = row / np.linalg.norm(row)
    return -q if q[3] < 0.0 else q


def make_pose(
    xyz: npt.ArrayLike = (0.0, 0.0, 0.0), rotation: npt.ArrayLike | None = None
) -> FloatArray:
    """Pose ``(4, 4)`` from a translation and a rotation.

    Args:
        xyz: ``(3,)`` translation [m].
        rotation: ``(3, 3)`` matrix, ``(3,)`` roll-pitch-yaw [rad] or ``(4,)`` quaternion
            x, y, z, w; nothing for the identity.

    Raises:
        ValueError: for any other shape.
    """
    X = np.eye(4)
    X[:3, 3] = _vector(xyz, 3, "xyz")
    if rotation is not None:
        R = np.asarray(rotation, dtype=np.float64)
        if R.shape == (3, 3):
            X[:3, :3] = R
        elif R.shape == (3,):
            X[:3, :3] = rpy_to_matrix(R)
        elif R.shape == (4,):
            X[:3, :3] = quaternion_xyzw_to_matrix(R)
        else:
            raise ValueError(f"rotation: shape (3, 3), (3,) or (4,) is needed, not {R.shape}")
    return X


def inverse_pose(X_AB: npt.ArrayLike) -> FloatArray:
    """X_BA ``(4, 4)`` of X_AB: transposed rotation, no matrix inversion."""
    X = np.asarray(X_AB, dtype=np.float64)
    if X.shape != (4, 4):
        raise ValueError(f"X_AB: shape (4, 4) is needed, not {X.shape}")
    inverse = np.eye(4)
    inverse[:3, :3] = X[:3, :3].T
    inverse[:3, 3] = -X[:3, :3].T @ X[:3, 3]
    return inverse


def tip_quaternion(p: npt.ArrayLike, roll: float) -> FloatArray:
    """Orientation of a tool whose tip is at p, with an absolute roll.

    R = minimal rotation (z to p) * Rz(roll), see docs/reference/conventions.md.

    Args:
        p: ``(3,)`` tip in the rcm frame [m], not above the trocar.
        roll: [rad].

    Returns:
        Unit quaternion ``(x, y, z, w)``.
    """
    px, py, pz = (float(v) for v in _vector(p, 3, "p"))
    x, y, w = -py, px, math.hypot(px, py, pz) + pz  # (z x p, |p| + z . p)
    length = math.hypot(x, y, w)
    x, y, w = x / length, y / length, w / length
    c, n = math.cos(roll / 2.0), math.sin(roll / 2.0)
    return np.array([x * c + y * n, y * c - x * n, w * n, w * c])
