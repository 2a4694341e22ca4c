"""Lens from views of the board: the simplest model that predicts views it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from surg_core.lens_file import DISTORTION_MODELS
from surg_core.pictures.lens_model import MODELS, LensModel
from surg_core.transforms import FloatArray, skew
from surg_perception.calibration.adjustment import Adjusted, adjust
from surg_perception.calibration.small_motions import moved

GOOD_ENOUGH = 1.05
"""A simpler model wins when its held-out error is at most this many times the best one's."""


@dataclass(frozen=True)
class SeenCorners:
    """Corners of one view in one eye.

    Attributes:
        p_Board: ``(n, 3)`` in the board frame [m].
        pixels: ``(n, 2)`` [px].
    """

    p_Board: FloatArray
    pixels: FloatArray


class Look(NamedTuple):
    """Residuals (2n,) of one view in one eye [px], and their derivatives.

    Attributes:
        r: Found less seen.
        by_board: ``(2n, 6)`` by a step of the board's pose before the left eye.
        by_eye: ``(2n, 6)`` by a step of this eye's pose in the left one.
        by_values: ``(2n, v)`` by the values of the lens.
    """

    r: FloatArray
    by_board: FloatArray
    by_eye: FloatArray
    by_values: FloatArray


def look(lens: LensModel, X_LE: FloatArray, X_LBoard: FloatArray, seen: SeenCorners) -> Look:
    """What an eye at X_LE (4, 4) should see of a board at X_LBoard (4, 4), against what it sees."""
    R_EL, turned = X_LE[:3, :3].T, seen.p_Board @ X_LBoard[:3, :3].T
    away = turned + X_LBoard[:3, 3] - X_LE[:3, 3]
    found, by_point, by_values = lens.derivatives(away @ R_EL.T)
    by_shift = by_point @ R_EL
    by_board = np.concatenate([-by_shift @ skew(turned), by_shift], axis=2)
    by_eye = np.concatenate([by_shift @ skew(away), -by_shift], axis=2)
    rows = found.size
    return Look(
        (found - seen.pixels).ravel(),
        by_board.reshape(rows, 6),
        by_eye.reshape(rows, 6),
        by_values.reshape(rows, len(lens.values)),
    )


@dataclass(frozen=True)
class LensProblem:
    """One lens and the board's pose in each view.

    Attributes:
        lens: The lens.
        X_CBoard: Pose (4, 4) of the board before the camera, of each view.
        seen: What each view shows.
    """

    lens: LensModel
    X_CBoard: list[FloatArray]
    seen: Sequence[SeenCorners]

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.seen)

    def linearise(self, view: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As ``adjustment.Problem``."""
        each = look(self.lens, np.eye(4), self.X_CBoard[view], self.seen[view])
        return each.r, each.by_values, each.by_board

    def moved(self, shared: FloatArray, own: list[FloatArray]) -> LensProblem:
        """As ``adjustment.Problem``."""
        poses = [moved(X, step) for X, step in zip(self.X_CBoard, own, strict=True)]
        return replace(self, lens=self.lens.moved(shared), X_CBoard=poses)


@dataclass(frozen=True)
class PoseProblem:
    """The board's pose before one or two known eyes; the pose is the only shared parameter.

    Attributes:
        X_LBoard: Pose (4, 4) of the board before the left eye.
        eyes: Of each eye: lens, its pose in the left one (4, 4).
        seen: What each eye sees.
    """

    X_LBoard: FloatArray
    eyes: Sequence[tuple[LensModel, FloatArray]]
    seen: Sequence[SeenCorners]
    views: int = 1

    def linearise(self, view: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As ``adjustment.Problem``."""
        looks = [
            look(*eye, self.X_LBoard, seen) for eye, seen in zip(self.eyes, self.seen, strict=True)
        ]
        r = np.concatenate([each.r for each in looks])
        return r, np.concatenate([each.by_board for each in looks]), np.zeros((len(r), 0))

    def moved(self, shared: FloatArray, own: list[FloatArray]) -> PoseProblem:
        """As ``adjustment.Problem``."""
        return replace(self, X_LBoard=moved(self.X_LBoard, shared))


def board_pose(lens: LensModel, seen: SeenCorners) -> FloatArray:
    """A first estimate (4, 4) of the board's pose before the camera (Collins and Bartoli, 2014)."""
    rays = lens.rays(seen.pixels)[:, :2]
    good = np.isfinite(rays).all(axis=1)
    done, r, t = cv2.solvePnP(
        seen.p_Board[good], rays[good], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    if not done:
        raise ValueError("the board's pose cannot be estimated")
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = cv2.Rodrigues(r)[0], t.ravel()
    return X


def fit_lens(
    seen: Sequence[SeenCorners], size: tuple[int, int], model: str
) -> Adjusted[LensProblem]:
    """The lens of one model with the least squared residuals.

    Args:
        seen: What each view shows; three views or more.
        size: Width and height of the pictures [px].
        model: One of ``MODELS``.
    """
    K = cv2.initCameraMatrix2D(
        [each.p_Board.astype(np.float32) for each in seen],
        [each.pixels.astype(np.float32) for each in seen],
        size,
        0.0,
    )
    values = np.concatenate(
        [[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], np.zeros(DISTORTION_MODELS[model])]
    )
    lens = LensModel(model, size, values)
    poses = [board_pose(lens, each) for each in seen]
    return adjust(LensProblem(lens, poses, seen))


def held_out_error(fit: Adjusted[LensProblem]) -> float:
    """Residual of each view under the lens fitted without it, rms over the views [px]."""
    problem = fit.solution
    errors = []
    for view, step in enumerate(fit.without()):
        eye = (problem.lens.moved(step), np.eye(4))
        alone = PoseProblem(problem.X_CBoard[view], [eye], [problem.seen[view]])
        errors.append(adjust(alone).rms)
    return float(np.sqrt(np.mean(np.square(errors))))


def choose_model(
    seen: Sequence[Sequence[SeenCorners]], size: tuple[int, int]
) -> tuple[str, dict[str, float]]:
    """The simplest model whose held-out error is within 5 % of the best one's.

    Args:
        seen: Of each eye, what each view shows.
        size: Width and height of the pictures [px].

    Returns:
        The model, and the held-out error of every model, rms over the eyes [px].
    """
    errors = {}
    for model in MODELS:
        each = [held_out_error(fit_lens(eye, size, model)) for eye in seen]
        errors[model] = float(np.sqrt(np.mean(np.square(each))))
    best = min(error for error in errors.values() if np.isfinite(error))
    return next(m for m in MODELS if errors[m] <= GOOD_ENOUGH * best), errors


@dataclass(frozen=True)
class LensFit:
    """One lens with the evidence.

    Attributes:
        fit: The adjustment; ``fit.solution.lens`` is the result.
        errors_of_models: Held-out error of each lens model [px].
    """

    fit: Adjusted[LensProblem]
    errors_of_models: dict[str, float]

    @property
    def lens(self) -> LensModel:
        """The result."""
        return self.fit.solution.lens

    @property
    def held_out(self) -> float:
        """Residual of views under the solution without them, rms [px]."""
        return self.errors_of_models[self.lens.model]


def solve_lens(seen: Sequence[SeenCorners], size: tuple[int, int]) -> LensFit:
    """The lens of a single eye, by the simplest good model.

    Args:
        seen: What each view shows.
        size: Width and height of the pictures [px].
    """
    model, errors = choose_model([seen], size)
    return LensFit(fit_lens(seen, size, model), errors)
