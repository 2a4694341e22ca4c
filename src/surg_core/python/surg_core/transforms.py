"""Rotations and poses as numpy arrays.

Poses ``X_AB`` are ``(4, 4)`` homogeneous float64 arrays: the pose of frame B in frame A.
Quaternions are ``(x, y, z, w)``, as on the wire. Roll, pitch, yaw are those of URDF: turns about
the fixed axes x, y, z, in this order. Functions of whole series take one rotation per row.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from surg_core._core import minimal_rotation as minimal_rotation

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


def skew(v: FloatArray) -> FloatArray:
    """Matrices ``(…, 3, 3)`` [v] with [v] x = v cross x; v is ``(…, 3)``."""
    matrix = np.zeros((*v.shape, 3))
    matrix[..., (2, 0, 1), (1, 2, 0)] = v
    matrix[..., (1, 2, 0), (2, 0, 1)] = -v
    return matrix


def rotation_of(w: FloatArray) -> FloatArray:
    """Rotation (3, 3) of a rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(w))
    return np.eye(3) if angle < 1e-300 else axis_angle_to_matrix(w, angle)


def rotation_vector(R: FloatArray) -> FloatArray:
    """Rotation vector (3,) [rad] of a rotation (3, 3); its length is at most pi."""
    sine = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    s, c = float(np.linalg.norm(sine)), 0.5 * (float(np.trace(R)) - 1.0)
    angle = math.atan2(s, c)
    if s > 1e-6:
        return np.asarray(sine * (angle / s))
    if c > 0.0:
        return sine
    values, vectors = np.linalg.eigh((R + R.T) / 2.0)  # half a turn: the axis, of either sign
    return np.asarray(angle * vectors[:, int(np.argmax(values))])


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


def virtual_tip(yaw: npt.ArrayLike, pitch: npt.ArrayLike, insertion: npt.ArrayLike) -> FloatArray:
    """Tip ``(…, 3)`` [m] in the rcm frame from virtual joints.

    p = insertion * (sin yaw cos pitch, sin pitch, cos yaw cos pitch), see
    docs/reference/conventions.md.

    Args:
        yaw: [rad].
        pitch: [rad].
        insertion: [m].
    """
    across = np.cos(pitch)
    s = np.stack([np.sin(yaw) * across, np.sin(pitch), np.cos(yaw) * across], axis=-1)
    return np.asarray(s * np.asarray(insertion, dtype=np.float64)[..., None])


def virtual_joints(p: npt.ArrayLike, roll: float) -> FloatArray:
    """Virtual joints of a tip, the inverse of :func:`virtual_tip`.

    Args:
        p: ``(3,)`` tip in the rcm frame [m].
        roll: Absolute roll [rad].

    Returns:
        ``(4,)`` yaw, pitch [rad], insertion [m], roll [rad].

    Raises:
        ValueError: p is the pivot itself, or not finite.
    """
    tip = _vector(p, 3, "p")
    depth = float(np.linalg.norm(tip))
    if not np.isfinite(depth) or depth < 1e-9:
        raise ValueError(f"p: {tip.tolist()} has no direction from the trocar")
    x, y, z = tip / depth
    return np.array([np.arctan2(x, z), np.arcsin(np.clip(y, -1.0, 1.0)), depth, roll])


def twist_angle(rotations: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Twist of rotations about z, by swing and twist: R = swing * Rz(twist).

    The swing is the part whose axis is perpendicular to z: pitch and yaw of a handle.

    Args:
        rotations: ``(…, 3, 3)`` rotation matrices.

    Returns:
        The twist ``(…)`` within ±pi [rad] and its quality ``(…)``: ``|cos(swing / 2)|``. At 0, a
        swing of half a turn, the twist is undefined.
    """
    R = np.asarray(rotations, dtype=np.float64)
    # twist = 2 atan2(q_z, q_w) of the quaternion of R. From the matrix, without normalising:
    # (r21 - r12, r11 + r22) = (1 + cos swing) (sin twist, cos twist).
    sine = R[..., 1, 0] - R[..., 0, 1]
    cosine = R[..., 0, 0] + R[..., 1, 1]
    return np.arctan2(sine, cosine), np.sqrt(np.hypot(sine, cosine) / 2.0)


CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
"""Times a unit quaternion x, y, z, w: the turn back."""


def multiply_quaternions(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of quaternions x, y, z, w, ``(…, 4)``, row by row: first b, then a."""
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    product = (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
    return np.stack(product, axis=-1)


def turn_between(q: FloatArray, q_next: FloatArray) -> FloatArray:
    """Rotation vector (3,) [rad] that turns a quaternion ``(4,)`` into the next; at most pi."""
    *v, w = multiply_quaternions(q_next, q * CONJUGATE).tolist()
    sine = math.hypot(*v)
    angle = 2.0 * math.atan2(sine, abs(w))
    return np.array(v) * (math.copysign(angle, w) / sine if sine > 0.0 else 0.0)


def rotate(q_AB: FloatArray, v_B: FloatArray) -> FloatArray:
    """Vectors ``(N, 3)`` in the axes of B, in those of A; ``q_AB`` ``(N, 4)`` unit quaternions."""
    u, w = q_AB[:, :3], q_AB[:, 3:]
    t = 2.0 * np.cross(u, v_B)
    return np.asarray(v_B + w * t + np.cross(u, t))


def rotate_back(q_AB: FloatArray, v_A: FloatArray) -> FloatArray:
    """Vectors ``(N, 3)`` in the axes of A, in those of B: the inverse of :func:`rotate`."""
    return rotate(q_AB * CONJUGATE, v_A)


def tip_quaternions(s_R: FloatArray, roll: FloatArray) -> FloatArray:
    """Orientations ``(N, 4)`` of a tool, as :func:`tip_quaternion`.

    Args:
        s_R: ``(N, 3)`` unit shaft axes in the rcm frame.
        roll: ``(N,)`` absolute roll [rad].
    """
    x, y, z = s_R.T
    # Minimal rotation: axis z x s, half the angle.
    swing = np.column_stack([-y, x, np.zeros_like(x), 1.0 + z])
    swing /= np.linalg.norm(swing, axis=1, keepdims=True)
    zero = np.zeros_like(roll)
    twist = np.column_stack([zero, zero, np.sin(roll / 2), np.cos(roll / 2)])
    return multiply_quaternions(swing, twist)


def slerp(a: FloatArray, b: FloatArray, part: FloatArray) -> FloatArray:
    """Spherical linear interpolation of unit quaternions along the shorter arc (Shoemake 1985).

    Args:
        a: ``(N, 4)`` where part is 0.
        b: ``(N, 4)`` where part is 1, of either sign.
        part: ``(N,)`` in [0, 1].

    Returns:
        ``(N, 4)`` unit quaternions.
    """
    part = part[:, None]
    b = np.where(np.sum(a * b, axis=1, keepdims=True) < 0.0, -b, b)
    # The angle from chord and sum is exact for small angles, where acos of the dot is not.
    angle = 2.0 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    angle = angle[:, None]
    small = angle < 1e-9
    safe = np.where(small, 1.0, np.sin(angle))
    near = np.where(small, 1.0 - part, np.sin((1.0 - part) * angle) / safe)
    far = np.where(small, part, np.sin(part * angle) / safe)
    found = near * a + far * b
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def continuous_quaternions(quaternions: FloatArray) -> FloatArray:
    """The same rotations ``(N, 4)``, signed so that neighbours are near; the first has w >= 0."""
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    sign = np.concatenate([[1.0], np.where(flips, -1.0, 1.0)]).cumprod()[: len(quaternions)]
    if len(quaternions) and quaternions[0, 3] < 0.0:
        sign = -sign
    return quaternions * sign[:, None]
