"""Kinematics of UR's e-Series by the maker's Denavit-Hartenberg parameters.

The emulator must not share code with what it tests: nothing here reads a URDF. Poses are in UR's
own `base` frame, which is ROS's `base_link` turned by 180 degrees about z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Matrix = NDArray[np.float64]
Table = Sequence[tuple[float, float, float]]

_UP = math.pi / 2.0
TABLES: dict[str, Table] = {
    "UR3e": (
        (0.15185, 0.0, _UP),
        (0.0, -0.24355, 0.0),
        (0.0, -0.2132, 0.0),
        (0.13105, 0.0, _UP),
        (0.08535, 0.0, -_UP),
        (0.0921, 0.0, 0.0),
    ),
    "UR5e": (
        (0.1625, 0.0, _UP),
        (0.0, -0.425, 0.0),
        (0.0, -0.3922, 0.0),
        (0.1333, 0.0, _UP),
        (0.0997, 0.0, -_UP),
        (0.0996, 0.0, 0.0),
    ),
    "UR10e": (
        (0.1807, 0.0, _UP),
        (0.0, -0.6127, 0.0),
        (0.0, -0.57155, 0.0),
        (0.17415, 0.0, _UP),
        (0.11985, 0.0, -_UP),
        (0.11655, 0.0, 0.0),
    ),
}
"""Model -> d [m], a [m], alpha [rad] of each joint (standard DH; UR's support pages)."""


def link(theta: float, d: float, a: float, alpha: float) -> Matrix:
    """One step of a standard DH chain, (4, 4)."""
    ct, st, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def frames(q: Sequence[float], table: Table) -> list[Matrix]:
    """Frames 0 to 6 of the chain in `base`, each (4, 4); the last one is the flange.

    Args:
        q: Joint angles [rad].
        table: d [m], a [m], alpha [rad] of each joint.
    """
    poses = [np.eye(4)]
    for theta, row in zip(q, table, strict=True):
        poses.append(poses[-1] @ link(theta, *row))
    return poses


def jacobian(q: Sequence[float], table: Table, X_FTcp: Matrix) -> Matrix:
    """Geometric Jacobian of the tool centre point in `base`: (6, 6), linear rows first."""
    poses = frames(q, table)
    p_tcp = (poses[-1] @ X_FTcp)[:3, 3]
    columns = [np.r_[np.cross(X[:3, 2], p_tcp - X[:3, 3]), X[:3, 2]] for X in poses[:-1]]
    return np.stack(columns, axis=1)


def inverse(
    X_BTcp: Matrix, near: Sequence[float], table: Table, X_FTcp: Matrix
) -> list[float] | None:
    """Joint angles [rad] of a pose, by damped Newton steps from `near`; None: none found."""
    q = np.array(near, dtype=np.float64)
    for _ in range(60):
        X = frames(list(q), table)[-1] @ X_FTcp
        rotation = rotation_vector(X_BTcp[:3, :3] @ X[:3, :3].T)
        error = np.r_[X_BTcp[:3, 3] - X[:3, 3], rotation]
        if float(np.abs(error).max()) < 1e-9:
            return [float(value) for value in q]
        J = jacobian(list(q), table, X_FTcp)
        step = J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), error)
        q += step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
    return None


def rotation_vector(R: Matrix) -> Matrix:
    """Rotation vector [rad] of a rotation matrix, (3,); its length is at most pi."""
    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def rotation_matrix(vector: Sequence[float]) -> Matrix:
    """Rotation matrix of a rotation vector [rad], (3, 3)."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def pose_vector(X: Matrix) -> list[float]:
    """UR's pose: position [m] and rotation vector [rad], 6 numbers."""
    return [*X[:3, 3].tolist(), *rotation_vector(X[:3, :3]).tolist()]


def pose_matrix(pose: Sequence[float]) -> Matrix:
    """Matrix (4, 4) of UR's pose: position [m] and rotation vector [rad]."""
    X = np.eye(4)
    X[:3, 3] = pose[:3]
    X[:3, :3] = rotation_matrix(pose[3:])
    return X
