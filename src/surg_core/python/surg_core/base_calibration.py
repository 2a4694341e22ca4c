"""Where a second arm's base is, from points that both arms' tips have touched.

The tips of the two arms touch the same points, one after the other, in the same order. Each arm
knows the points in its own base; the rigid transform between the two sets is that between the
bases. It has a closed form: B. K. P. Horn, "Closed-form solution of absolute orientation using unit
quaternions", 1987; here by the singular value decomposition of K. S. Arun et al., 1987.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core._core import CalibrationError
from surg_core.transforms import FloatArray

LEAST_POINTS = 6
LARGEST_RMS = 0.001
"""[m] Of the distances that remain between the two arms' points."""
LEAST_SPREAD = 0.005
"""[m] rms distance of the points from their best plane: below it the rotation is guessed."""
STEADIEST_HAND = 1e-5
"""[m] Error of a touched point, one axis, that a fit never falls below."""


@dataclass(frozen=True)
class BasesFit:
    """The second base in the first one.

    Attributes:
        X_B1B2: (4, 4) pose of the second arm's base in the first one's.
        rms: Of the remaining distances [m].
        worst: The largest remaining distance [m].
        worst_point: Its number in the recording, from 1.
        n: Number of points.
        condition: Largest over smallest spread of the points; 1 is best.
        covariance: (6, 6) of X_B1B2 in the first base's axes, rotation first; see
            ``pose_evidence.Evidence``.
    """

    X_B1B2: FloatArray
    rms: float
    worst: float
    worst_point: int
    n: int
    condition: float
    covariance: FloatArray


def solve_bases(p_B1: FloatArray, p_B2: FloatArray) -> BasesFit:
    """The rigid transform with ``p_B1 = X_B1B2 p_B2`` in the least-squares sense.

    Args:
        p_B1: (n, 3) points in the first arm's base [m].
        p_B2: (n, 3) the same points, in the same order, in the second arm's base [m].

    Raises:
        CalibrationError: Fewer than six points or of different number, not finite, all near one
            plane, or they remain more than 1 mm apart (rms).
    """
    first, second = np.asarray(p_B1, dtype=np.float64), np.asarray(p_B2, dtype=np.float64)
    if first.shape != second.shape or first.ndim != 2 or first.shape[1] != 3:
        raise CalibrationError(
            f"{len(first)} points of the first arm, {len(second)} of the second: both must touch "
            "the same points in the same order"
        )
    n = len(first)
    if n < LEAST_POINTS:
        raise CalibrationError(f"{n} points; at least {LEAST_POINTS} are needed")
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise CalibrationError("a point is not finite")
    centre1, centre2 = first.mean(axis=0), second.mean(axis=0)
    spread = min((_spread(p - c) for p, c in ((first, centre1), (second, centre2))), key=min)
    if not spread[2] >= LEAST_SPREAD:
        raise CalibrationError(
            f"the points lie within {1e3 * spread[2]:.1f} mm (rms) of one plane; at least "
            f"{1e3 * LEAST_SPREAD:g} mm are needed: touch points at different heights"
        )
    U, _, Vt = np.linalg.svd((second - centre2).T @ (first - centre1))
    # Without the sign a mirrored set would give a reflection.
    R = Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    X_B1B2 = np.eye(4)
    X_B1B2[:3, :3], X_B1B2[:3, 3] = R, centre1 - R @ centre2
    away = np.linalg.norm(first - (second @ R.T + X_B1B2[:3, 3]), axis=1)
    worst = int(np.argmax(away))
    rms = float(np.sqrt(np.mean(away**2)))
    if not rms <= LARGEST_RMS:
        raise CalibrationError(
            f"the two arms' points remain {1e3 * rms:.2f} mm apart (rms), the worst is point "
            f"{worst + 1} with {1e3 * away[worst]:.2f} mm; allowed are {1e3 * LARGEST_RMS:g} mm: "
            "touch the same points in the same order, with calibrated tools"
        )
    covariance = _covariance(first - X_B1B2[:3, 3], rms)
    condition = float(spread[0] / spread[2])
    return BasesFit(X_B1B2, rms, float(away[worst]), worst + 1, n, condition, covariance)


def _covariance(arms: FloatArray, rms: float) -> FloatArray:
    """Of (theta, d), where each point is touched with an error of its own.

    Least squares: sigma^2 (J^T J)^-1 with J = [-[r] I] for a point at r (3,) from the base's
    origin. ``arms`` is (n, 3), ``rms`` that of the distances which remain [m].
    """
    n = len(arms)
    J = np.zeros((n, 3, 6))
    x, y, z = arms.T
    J[:, 0, 1], J[:, 0, 2] = z, -y
    J[:, 1, 0], J[:, 1, 2] = -z, x
    J[:, 2, 0], J[:, 2, 1] = y, -x
    J[:, :, 3:] = np.eye(3)
    variance = max(n * rms**2 / (3 * n - 6), STEADIEST_HAND**2)
    stacked = J.reshape(-1, 6)
    C = variance * np.linalg.inv(stacked.T @ stacked)
    return np.asarray((C + C.T) / 2)


def in_axes(covariance: FloatArray, R: FloatArray) -> FloatArray:
    """A covariance (6, 6) in other axes: R (3, 3) turns from the old axes to the new ones."""
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R
    C = turn @ covariance @ turn.T
    return np.asarray((C + C.T) / 2)


def _spread(centred: FloatArray) -> FloatArray:
    """Root mean square extents of a centred set along its principal axes, largest first (3,)."""
    return np.linalg.svd(centred, compute_uv=False) / np.sqrt(len(centred))
