"""Where the base of the instrument's arm is, seen from the base of the endoscope's arm.

*By touch*: the tip touches corners of the board that the scope sees. The board may be moved between
touches, which spreads the points. *By tip*: the scope sees the
tip itself. Both give points that each arm states in its own base; a rigid fit joins them. The tip
that is followed in pictures lies up the shaft, so by tip only the turn counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core.transforms import FloatArray, inverse_pose
from surg_perception.calibration.adjustment import jackknife
from surg_perception.calibration.small_motions import (
    difference,
    expected_error,
    moved,
    shift_at,
    transform,
)
from surg_perception.calibration.triangulation import rigid_fit


@dataclass(frozen=True)
class SeenBase:
    """The instrument arm's base T in the scope arm's base S.

    Attributes:
        X_ST: (4, 4).
        covariance: (6, 6) rotation first, axes of S: of the points and of the hand-eye pose.
        rms: Of the distances that remain [m].
        n: Number of points.
        spread: Extents of the points, rms along their principal axes, largest first (3,) [m].
        middle: (3,) of the points, in S [m].
    """

    X_ST: FloatArray
    covariance: FloatArray
    rms: float
    n: int
    spread: FloatArray
    middle: FloatArray

    @property
    def error(self) -> tuple[float, float]:
        """Expected error: of the turn [rad], and of the place amid the points [m]."""
        turn, _ = expected_error(self.covariance)
        return turn, shift_at(self.covariance, self.middle - self.X_ST[:3, 3])


def solve_base(
    p_S: FloatArray,
    p_T: FloatArray,
    X_SF: FloatArray,
    X_FV: FloatArray,
    handeye_covariance: FloatArray,
) -> SeenBase:
    """The instrument arm's base in the scope arm's base, with a jackknife over the points.

    Args:
        p_S: (n, 3) the points as the scope sees them, in its arm's base [m].
        p_T: (n, 3) the tip by its joints, in the instrument arm's base [m].
        X_SF: (n, 4, 4) flange of the scope's arm.
        X_FV: (4, 4) the left eye in that flange.
        handeye_covariance: (6, 6) of X_FV; its part of the error is added.
    """
    n = len(p_S)
    X_ST = rigid_fit(p_T, p_S)
    steps = [
        difference(rigid_fit(np.delete(p_T, k, axis=0), np.delete(p_S, k, axis=0)), X_ST)
        for k in range(n)
    ]
    J = _by_handeye(X_ST, X_SF, X_FV)
    covariance = jackknife(np.array(steps)) + J @ handeye_covariance @ J.T
    away = np.linalg.norm(p_S - transform(X_ST, p_T), axis=1)
    middle = p_S.mean(axis=0)
    spread = np.linalg.svd(p_S - middle, compute_uv=False) / np.sqrt(n)
    return SeenBase(X_ST, covariance, float(np.sqrt(np.mean(away**2))), n, spread, middle)


def _by_handeye(X_ST: FloatArray, X_SF: FloatArray, X_FV: FloatArray) -> FloatArray:
    """Derivative (6, 6) of X_ST by a step of X_FV, mean over the scope's postures.

    What the eye sees moves with the eye: X_ST becomes X_SF X_FV' X_FV^-1 X_SF^-1 X_ST.
    """
    J = np.zeros((6, 6))
    step = 1e-6
    for k in range(6):
        change = moved(X_FV, step * np.eye(6)[k]) @ inverse_pose(X_FV)
        each = [difference(X @ change @ inverse_pose(X) @ X_ST, X_ST) / step for X in X_SF]
        J[:, k] = np.mean(each, axis=0)
    return J
