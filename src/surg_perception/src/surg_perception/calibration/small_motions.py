"""Small motions of poses: how a solver moves a pose, and in which terms a covariance is stated.

A step ``(6,)`` of a pose X_AB is a rotation vector and a translation, both in the axes of A: the
rotation becomes exp(w) R, the position p + v.
"""

from __future__ import annotations

import math

import numpy as np

from surg_core.transforms import FloatArray, rotation_of, rotation_vector, skew


def moved(X_AB: FloatArray, step: FloatArray) -> FloatArray:
    """The pose (4, 4) after a step (6,)."""
    X = X_AB.copy()
    X[:3, :3] = rotation_of(step[:3]) @ X[:3, :3]
    X[:3, 3] += step[3:]
    return X


def difference(X_AB: FloatArray, X_AB0: FloatArray) -> FloatArray:
    """The step (6,) that takes X_AB0 to X_AB."""
    turned = rotation_vector(X_AB[:3, :3] @ X_AB0[:3, :3].T)
    return np.concatenate([turned, X_AB[:3, 3] - X_AB0[:3, 3]])


def covariance_of_inverse(X_AB: FloatArray, covariance: FloatArray) -> FloatArray:
    """Covariance (6, 6) of X_BA from that of X_AB."""
    R_BA = X_AB[:3, :3].T
    J = np.zeros((6, 6))
    J[:3, :3] = -R_BA
    # p_BA = -R_BA p_AB; with exp(w): -R_BA (1 - [w]x) p_AB = p_BA - R_BA [p_AB]x w.
    J[3:, :3] = -R_BA @ skew(X_AB[:3, 3])
    J[3:, 3:] = -R_BA
    return np.asarray(J @ covariance @ J.T)


def transform(X_AB: FloatArray, p_B: FloatArray) -> FloatArray:
    """Points (n, 3) of B in A."""
    return np.asarray(p_B @ X_AB[:3, :3].T + X_AB[:3, 3])


def expected_error(covariance: FloatArray) -> tuple[float, float]:
    """Expected error of a pose: of its rotation [rad] and position [m], one sigma of the length."""
    return math.sqrt(np.trace(covariance[:3, :3])), math.sqrt(np.trace(covariance[3:, 3:]))


def mean_pose(poses: FloatArray) -> FloatArray:
    """The mean (4, 4) of poses (n, 4, 4): mean position, nearest rotation to the mean matrix."""
    X = poses.mean(axis=0)
    X[:3, :3] = nearest_rotation(X[:3, :3])
    return np.asarray(X)


def nearest_rotation(M: FloatArray) -> FloatArray:
    """The rotation (3, 3) nearest to a matrix."""
    U, _, Vt = np.linalg.svd(M)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt)


def shift_at(covariance: FloatArray, lever: FloatArray) -> float:
    """Expected shift [m] of a point that a pose carries, one sigma of the length.

    Args:
        covariance: (6, 6) of the pose X_AB, rotation first, axes of A.
        lever: (3,) from the origin of B to the point, axes of A [m].
    """
    J = np.hstack([-skew(lever), np.eye(3)])
    return float(np.sqrt(np.trace(J @ covariance @ J.T)))
