"""Where the base of the instrument's arm is, seen from the base of the endoscope's arm.

*By touch*: the tip touches corners of the board that the scope sees. The board may be moved between
touches, which spreads the points. *By tip*: the scope sees the tip itself. Both give points that
each arm states in its own base; a rigid fit joins them. The tip that is followed in pictures lies
up the shaft, so by tip only the turn counts.

The followed tip looks different from place to place: its error changes smoothly over the view. The
rigid fit takes the part of such an error that turns the points for a turn of the base, and leaving
out a point does not show it. The parts that stretch and shear the points remain, and
`turn_by_strain` states the turn that goes with them.
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
        handeye_covariance: (6, 6) its part that the hand-eye pose causes; more points leave it.
        rms: Of the distances that remain [m].
        n: Number of points.
        p_S: (n, 3) the points as the scope sees them, in S [m].
        residuals: (n, 3) from there to the tip by its joints, in S [m].
        X_SV: (4, 4) the left eye at the first point.
        spread: Extents of the points, rms along their principal axes, largest first (3,) [m].
        middle: (3,) of the points, in S [m].
    """

    X_ST: FloatArray
    covariance: FloatArray
    handeye_covariance: FloatArray
    rms: float
    n: int
    p_S: FloatArray
    residuals: FloatArray
    X_SV: FloatArray
    spread: FloatArray
    middle: FloatArray

    @property
    def error(self) -> tuple[float, float]:
        """Expected error: of the turn [rad], and of the place amid the points [m]."""
        return self._error(self.covariance)

    @property
    def camera_share(self) -> float:
        """Share of the hand-eye pose in the variance of the turn."""
        return float((self._error(self.handeye_covariance)[0] / max(self.error[0], 1e-300)) ** 2)

    def points_for(self, turn: float, shift: float) -> int | None:
        """Number of points, spread like these, that would bring the expected error below limits.

        Args:
            turn: Largest expected turn [rad].
            shift: Largest expected error of the place amid the points [m].

        Returns:
            The number; None: the hand-eye pose alone exceeds a limit.
        """
        by_all = np.square(self.error)
        by_handeye = np.square(self._error(self.handeye_covariance))
        allowed = np.square([turn, shift]) - by_handeye
        if not (allowed > 0.0).all():
            return None
        share = float(np.max((by_all - by_handeye) / allowed))
        return int(np.ceil(self.n * share)) if np.isfinite(share) else None

    def _error(self, covariance: FloatArray) -> tuple[float, float]:
        turn, _ = expected_error(covariance)
        return turn, shift_at(covariance, self.middle - self.X_ST[:3, 3])


def solve_base(
    p_S: FloatArray,
    p_T: FloatArray,
    X_SF: FloatArray,
    X_FV: FloatArray,
    handeye_covariance: FloatArray,
    smooth: bool = False,
) -> SeenBase:
    """The instrument arm's base in the scope arm's base, with a jackknife over the points.

    Args:
        p_S: (n, 3) the points as the scope sees them, in its arm's base [m].
        p_T: (n, 3) the tip by its joints, in the instrument arm's base [m].
        X_SF: (n, 4, 4) flange of the scope's arm.
        X_FV: (4, 4) the left eye in that flange.
        handeye_covariance: (6, 6) of X_FV, for what is seen through the same lenses; its part of
            the error is added.
        smooth: Whether the points' errors change smoothly over the view, as those of a followed
            tip do; the turn that they hide is added.
    """
    n = len(p_S)
    X_ST = rigid_fit(p_T, p_S)
    steps = [
        difference(rigid_fit(np.delete(p_T, k, axis=0), np.delete(p_S, k, axis=0)), X_ST)
        for k in range(n)
    ]
    J = _by_handeye(p_S, p_T, X_SF, X_FV)
    by_handeye = J @ handeye_covariance @ J.T
    covariance = jackknife(np.array(steps)) + by_handeye
    residuals = transform(X_ST, p_T) - p_S
    if smooth:
        covariance[:3, :3] += turn_by_strain(p_S, residuals) ** 2 * np.eye(3)
    middle = p_S.mean(axis=0)
    return SeenBase(
        X_ST=X_ST,
        covariance=covariance,
        handeye_covariance=by_handeye,
        rms=float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))),
        n=n,
        p_S=p_S,
        residuals=residuals,
        X_SV=X_SF[0] @ X_FV,
        spread=np.linalg.svd(p_S - middle, compute_uv=False) / np.sqrt(n),
        middle=middle,
    )


def turn_by_strain(p_S: FloatArray, residuals: FloatArray) -> float:
    """The turn about each axis that an error hides whose other linear parts remain, one sigma.

    An error that is linear in the place, e = A p, with nine independent terms of one variance s^2:
    its antisymmetric part turns the points by components of variance s^2 / 2, its shears have the
    same variance, its stretches s^2. A rigid fit leaves the last two: six terms that state s. What
    they say of a seventh is Student's t of six degrees, whose variance is six quarters as large.

    Args:
        p_S: (n, 3) the points [m].
        residuals: (n, 3) of the rigid fit [m].

    Returns:
        The turn [rad].
    """
    A = np.linalg.lstsq(p_S - p_S.mean(axis=0), residuals - residuals.mean(axis=0), rcond=None)[0]
    strain = (A + A.T) / 2.0
    shears, stretches = strain[np.triu_indices(3, 1)], np.diag(strain)
    return float(np.sqrt((np.sum(shears**2) + np.sum(stretches**2) / 2.0) / 4.0))


def _by_handeye(p_S: FloatArray, p_T: FloatArray, X_SF: FloatArray, X_FV: FloatArray) -> FloatArray:
    """Derivative (6, 6) of the fit by a step of X_FV; what the eye sees moves with the eye.

    In each posture of the scope a step moves its points otherwise, so the fit is made anew.
    """
    J, step = np.zeros((6, 6)), 1e-6
    X_ST = rigid_fit(p_T, p_S)
    for k in range(6):
        change = moved(X_FV, step * np.eye(6)[k]) @ inverse_pose(X_FV)
        seen = [
            transform(X @ change @ inverse_pose(X), p[None])[0]
            for X, p in zip(X_SF, p_S, strict=True)
        ]
        J[:, k] = difference(rigid_fit(p_T, np.array(seen)), X_ST) / step
    return J
