"""Both lenses and the pose between them, from pairs of views of the board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surg_core.transforms import FloatArray, inverse_pose
from surg_perception.calibration.adjustment import Adjusted, adjust
from surg_perception.calibration.intrinsics import (
    PoseProblem,
    SeenCorners,
    choose_model,
    fit_lens,
    look,
)
from surg_perception.calibration.small_motions import (
    expected_error,
    mean_pose,
    moved,
    transform,
)
from surg_perception.calibration.triangulation import Rectified, Stereo, rigid_fit

OUTLIER = 6.0
"""A corner this many times the typical residual away is a wrong detection."""


@dataclass(frozen=True)
class PairProblem:
    """Two lenses, the right eye's pose in the left one, the board's pose in each view.

    Attributes:
        stereo: Both eyes.
        X_LBoard: Pose (4, 4) of the board before the left eye, of each view.
        seen: What each view shows: left, right.
    """

    stereo: Stereo
    X_LBoard: list[FloatArray]
    seen: Sequence[tuple[SeenCorners, SeenCorners]]

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.seen)

    def linearise(self, view: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As ``adjustment.Problem``; shared: values of the left and the right lens, X_LR."""
        X, n = self.X_LBoard[view], len(self.stereo.left.values)
        left, right = (
            look(*eye, X, seen) for eye, seen in zip(self.stereo.eyes, self.seen[view], strict=True)
        )
        m = len(left.r)
        shared = np.zeros((m + len(right.r), 2 * n + 6))
        shared[:m, :n] = left.by_values
        shared[m:, n:] = np.hstack([right.by_values, right.by_eye])
        own = np.concatenate([left.by_board, right.by_board])
        return np.concatenate([left.r, right.r]), shared, own

    def moved(self, shared: FloatArray, own: list[FloatArray]) -> PairProblem:
        """As ``adjustment.Problem``."""
        poses = [moved(X, step) for X, step in zip(self.X_LBoard, own, strict=True)]
        return replace(self, stereo=self.stereo.moved(shared), X_LBoard=poses)


@dataclass(frozen=True)
class StereoFit:
    """Both lenses with the evidence.

    Attributes:
        fit: The adjustment; ``fit.solution.stereo`` is the result.
        errors_of_models: Held-out error of each lens model [px].
        held_out: Residual of views under the solution without them, rms [px].
        rows: Difference of a corner's rectified rows, held out, rms [px].
        errors: ``(n,)`` distance of held-out triangulated corners from the board's shape [m].
        distances: ``(n,)`` of these corners from the left eye [m].
        left_out: Number of corners taken as wrong detections.
    """

    fit: Adjusted[PairProblem]
    errors_of_models: dict[str, float]
    held_out: float
    rows: float
    errors: FloatArray
    distances: FloatArray
    left_out: int

    @property
    def stereo(self) -> Stereo:
        """The result."""
        return self.fit.solution.stereo

    @property
    def covariance(self) -> FloatArray:
        """Covariance (6, 6) of X_LR, rotation first, axes of the left eye."""
        return self.fit.covariance[-6:, -6:]

    @property
    def pose_error(self) -> tuple[float, float]:
        """Expected error of X_LR: rotation [rad], position [m]."""
        return expected_error(self.covariance)

    @property
    def spreads(self) -> tuple[FloatArray, FloatArray]:
        """Standard deviation of each value of the left and the right lens."""
        n = len(self.stereo.left.values)
        sd = np.sqrt(np.diag(self.fit.covariance))
        return sd[:n], sd[n : 2 * n]

    def error_at(self, distance: float) -> float:
        """Median distance of a held-out corner from its place [m], at a distance [m].

        An error of the disparity grows with the square of the distance.
        """
        return float(np.median(self.errors / self.distances**2) * distance**2)


def solve_stereo(
    seen: Sequence[tuple[SeenCorners, SeenCorners]], size: tuple[int, int], model: str = ""
) -> StereoFit:
    """Both lenses and the pose between them.

    Args:
        seen: What each view shows: left, right.
        size: Width and height of each picture [px].
        model: Of the lenses; empty: the simplest good one is chosen.
    """
    eyes = [[view[eye] for view in seen] for eye in (0, 1)]
    errors: dict[str, float] = {}
    if not model:
        model, errors = choose_model(eyes, size)
    left, right = (fit_lens(eye, size, model).solution for eye in eyes)
    poses = [L @ inverse_pose(R) for L, R in zip(left.X_CBoard, right.X_CBoard, strict=True)]
    stereo = Stereo(left.lens, right.lens, mean_pose(np.array(poses)))
    fit = adjust(PairProblem(stereo, left.X_CBoard, seen))
    kept, left_out = _without_outliers(fit)
    if left_out:
        fit = adjust(replace(fit.solution, seen=kept))
    held_out, rows, found, distances = _held_out(fit)
    return StereoFit(fit, errors, held_out, rows, found, distances, left_out)


def _without_outliers(
    fit: Adjusted[PairProblem],
) -> tuple[list[tuple[SeenCorners, SeenCorners]], int]:
    """What the views show without corners that lie far from where they should."""
    typical = np.median(np.abs(np.concatenate(fit.residuals))) / 0.6745
    limit = max(0.5, OUTLIER * float(typical))
    kept, left_out = [], 0
    for seen, r in zip(fit.solution.seen, fit.residuals, strict=True):
        away = np.linalg.norm(r.reshape(-1, 2), axis=1) <= limit
        n = len(seen[0].pixels)
        good = (away[:n], away[n:])
        left_out += int((~away).sum())
        left, right = (
            SeenCorners(each.p_Board[ok], each.pixels[ok])
            for each, ok in zip(seen, good, strict=True)
        )
        kept.append((left, right))
    return kept, left_out


def _held_out(fit: Adjusted[PairProblem]) -> tuple[float, float, FloatArray, FloatArray]:
    """Residual and row difference [px], error and distance of triangulated corners [m]."""
    problem = fit.solution
    pixels, rows, errors, distances = [], [], [], []
    for view, step in enumerate(fit.without()):
        stereo = problem.stereo.moved(step)
        pair = problem.seen[view]
        pixels.append(adjust(PoseProblem(problem.X_LBoard[view], stereo.eyes, pair)).rms)
        both, at_left, at_right = common(*pair)
        rectified = Rectified.of(stereo)
        rows.append(rectified.rows(at_left, at_right))
        p_L = stereo.triangulate(at_left, at_right)
        X = rigid_fit(both, p_L)
        errors.append(np.linalg.norm(p_L - transform(X, both), axis=1))
        distances.append(np.linalg.norm(p_L, axis=1))
    apart = np.concatenate(rows)
    return (
        float(np.sqrt(np.mean(np.square(pixels)))),
        float(np.sqrt(np.mean(apart**2))),
        np.concatenate(errors),
        np.concatenate(distances),
    )


def common(left: SeenCorners, right: SeenCorners) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Corners that both eyes see: on the board (n, 3), in the left and right picture (n, 2)."""
    keys = [[tuple(p) for p in np.round(each.p_Board, 9)] for each in (left, right)]
    where = {key: row for row, key in enumerate(keys[1])}
    pairs = [(row, where[key]) for row, key in enumerate(keys[0]) if key in where]
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return left.p_Board[rows[:, 0]], left.pixels[rows[:, 0]], right.pixels[rows[:, 1]]
