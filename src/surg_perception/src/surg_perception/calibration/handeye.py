"""The left eye in the flange of the arm that holds the endoscope.

The scope looks at a still board from many postures. A closed form (F. Park and B. Martin, "Robot
sensor calibration: solving AX = XB on the Euclidean group", 1994) starts an adjustment of the
residuals of all corners in both eyes over two poses: the eye in the flange, the board in the base.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surg_core.transforms import FloatArray, inverse_pose, rotation_vector, skew
from surg_perception.calibration.adjustment import Adjusted, adjust
from surg_perception.calibration.intrinsics import PoseProblem, SeenCorners, board_pose, look
from surg_perception.calibration.small_motions import (
    expected_error,
    mean_pose,
    moved,
    nearest_rotation,
)
from surg_perception.calibration.stereo import PairProblem
from surg_perception.calibration.triangulation import Stereo


@dataclass(frozen=True)
class HandEyeProblem:
    """The eye in the flange and the board in the base.

    Shared parameters: steps of X_FV and of X_BBoard. With ``free`` also two that should be 0: the
    logarithms of a factor of all focal lengths and of a factor of the board's size.

    Attributes:
        stereo: Both eyes, measured before.
        X_FV: Pose (4, 4) of the left eye in the flange.
        X_BBoard: Pose (4, 4) of the board in the robot base.
        X_BF: Pose (4, 4) of the flange, of each view.
        seen: What each view shows: left, right.
        free: Whether focal length and board size are parameters too.
        factors: (2,) logarithms of the factors of focal length and board size.
    """

    stereo: Stereo
    X_FV: FloatArray
    X_BBoard: FloatArray
    X_BF: FloatArray
    seen: Sequence[tuple[SeenCorners, SeenCorners]]
    free: bool = False
    factors: tuple[float, float] = (0.0, 0.0)

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.seen)

    def linearise(self, view: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As ``adjustment.Problem``."""
        X_FBoard = inverse_pose(self.X_BF[view]) @ self.X_BBoard
        X_VBoard, R_VF = inverse_pose(self.X_FV) @ X_FBoard, self.X_FV[:3, :3].T
        by_poses = np.zeros((6, 12))  # A step of the board before the eye, by steps of both poses.
        by_poses[:3, :3] = by_poses[3:, 3:6] = -R_VF
        by_poses[3:, :3] = R_VF @ skew(X_FBoard[:3, 3] - self.X_FV[:3, 3])
        by_poses[:3, 6:9] = by_poses[3:, 9:] = R_VF @ self.X_BF[view][:3, :3].T
        zoom, size = np.exp(self.factors)
        residuals, slopes = [], []
        for (lens, X_VE), seen in zip(self.stereo.eyes, self.seen[view], strict=True):
            zoomed = lens.moved(np.pad((zoom - 1.0) * lens.values[:2], (0, len(lens.values) - 2)))
            sized = replace(seen, p_Board=size * seen.p_Board)
            r, by_board, _, by_values = look(zoomed, X_VE, X_VBoard, sized)
            slope = by_board @ by_poses
            if self.free:
                by_zoom = by_values[:, :2] @ zoomed.values[:2]
                grown = np.repeat(sized.p_Board @ X_VBoard[:3, :3].T, 2, axis=0)
                by_size = np.sum(by_board[:, 3:] * grown, axis=1)
                slope = np.column_stack([slope, by_zoom, by_size])
            residuals.append(r)
            slopes.append(slope)
        r = np.concatenate(residuals)
        return r, np.concatenate(slopes), np.zeros((len(r), 0))

    def moved(self, shared: FloatArray, own: list[FloatArray]) -> HandEyeProblem:
        """As ``adjustment.Problem``."""
        factors = self.factors
        if self.free:
            factors = (factors[0] + float(shared[12]), factors[1] + float(shared[13]))
        return replace(
            self,
            X_FV=moved(self.X_FV, shared[:6]),
            X_BBoard=moved(self.X_BBoard, shared[6:12]),
            factors=factors,
        )


@dataclass(frozen=True)
class HandEyeFit:
    """The result with its evidence.

    Attributes:
        fit: The adjustment.
        factors: Of focal length and board size that would fit these views best.
        factors_sd: Standard deviations of both, by jackknife.
        turns: (2,) largest turn between two views, and largest turn about an axis across it [rad].
        lens_share: Covariance (6, 6) of X_FV that the lenses cause; None: nobody knows it.
    """

    fit: Adjusted[HandEyeProblem]
    factors: FloatArray
    factors_sd: FloatArray
    turns: FloatArray
    lens_share: FloatArray | None = None

    @property
    def X_FV(self) -> FloatArray:
        """The result."""
        return self.fit.solution.X_FV

    @property
    def covariance(self) -> FloatArray:
        """Covariance (6, 6) of X_FV, rotation first, axes of the flange: of views and lenses."""
        return self.of_views if self.lens_share is None else self.of_views + self.lens_share

    @property
    def of_views(self) -> FloatArray:
        """The part (6, 6) that other views would change; see `CameraCalibration.of_views`."""
        return self.fit.covariance[:6, :6]

    @property
    def pose_error(self) -> tuple[float, float]:
        """Expected error of X_FV: rotation [rad], position [m]."""
        return expected_error(self.covariance)


def solve_handeye(
    stereo: Stereo,
    X_BF: FloatArray,
    seen: Sequence[tuple[SeenCorners, SeenCorners]],
    lenses: FloatArray | None = None,
) -> HandEyeFit:
    """The left eye in the flange.

    Args:
        stereo: Both eyes.
        X_BF: (n, 4, 4) flange poses in the robot base.
        seen: What each view shows: left, right.
        lenses: (m, m) covariance of the eyes, as `LensCovariance`; None: unknown.
    """
    X_VBoard = np.array([pair_pose(stereo, pair) for pair in seen])
    X_FV = park(X_BF, X_VBoard)
    X_BBoard = mean_pose(X_BF @ X_FV @ X_VBoard)
    fit = adjust(HandEyeProblem(stereo, X_FV, X_BBoard, X_BF, seen))
    freed = adjust(replace(fit.solution, free=True))
    sd = np.sqrt(np.diag(freed.covariance)[12:])
    share = None if lenses is None else _lens_share(fit, lenses)
    return HandEyeFit(fit, np.exp(freed.solution.factors), sd, turns_between(X_BF), share)


def _lens_share(fit: Adjusted[HandEyeProblem], lenses: FloatArray) -> FloatArray:
    """Covariance (6, 6) of X_FV that the lenses' covariance (m, m) causes.

    A lens that is wrong is wrong in every view alike, so no jackknife over views shows it. By the
    implicit function theorem a step ds of the lenses moves the solution by -N^-1 J^T (dr/ds) ds.
    """
    problem = fit.solution
    X_VBoard = [inverse_pose(X @ problem.X_FV) @ problem.X_BBoard for X in problem.X_BF]
    pairs = PairProblem(problem.stereo, X_VBoard, problem.seen)
    m = len(lenses)
    by_lenses = sum(
        (problem.linearise(k)[1].T @ pairs.linearise(k)[1][:, :m] for k in range(problem.views)),
        np.zeros((12, m)),
    )
    moves = -np.linalg.solve(fit.normal.sum(axis=0), by_lenses)[:6]
    return np.asarray(moves @ lenses @ moves.T)


def pair_pose(stereo: Stereo, pair: tuple[SeenCorners, SeenCorners]) -> FloatArray:
    """Pose (4, 4) of the board before the left eye, from both eyes."""
    start = board_pose(stereo.left, pair[0])
    return adjust(PoseProblem(start, stereo.eyes, pair)).solution.X_LBoard


def park(X_BF: FloatArray, X_VBoard: FloatArray) -> FloatArray:
    """X_FV (4, 4) from flange poses and board poses (n, 4, 4), in closed form, from all pairs."""
    motions = []
    for i in range(len(X_BF)):
        for j in range(i):
            A = inverse_pose(X_BF[i]) @ X_BF[j]
            B = X_VBoard[i] @ inverse_pose(X_VBoard[j])
            motions.append((A, B))
    M = sum(
        (np.outer(rotation_vector(B[:3, :3]), rotation_vector(A[:3, :3])) for A, B in motions),
        np.zeros((3, 3)),
    )
    # R that turns each motion of the eye, seen in the eye, into that of the flange.
    R = nearest_rotation(M.T)
    left = np.concatenate([A[:3, :3] - np.eye(3) for A, _ in motions])
    right = np.concatenate([R @ B[:3, 3] - A[:3, 3] for A, B in motions])
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, np.linalg.lstsq(left, right, rcond=None)[0]
    return X


def turns_between(X_BF: FloatArray) -> FloatArray:
    """Largest turn between two views, and the largest one across its axis (2,) [rad]."""
    turns = np.array(
        [
            rotation_vector(X_BF[i, :3, :3].T @ X_BF[j, :3, :3])
            for i in range(len(X_BF))
            for j in range(i)
        ]
    )
    lengths = np.linalg.norm(turns, axis=1)
    axis = turns[np.argmax(lengths)] / max(float(lengths.max()), 1e-12)
    across = turns - np.outer(turns @ axis, axis)
    return np.array([lengths.max(), np.linalg.norm(across, axis=1).max()])
