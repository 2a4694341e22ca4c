"""Results of a calibration made up without a solver: their evidence is what a test states."""

from __future__ import annotations

from typing import Any

import numpy as np

from surg_core.pictures.lens_model import LensModel
from surg_perception.calibration.adjustment import Adjusted
from surg_perception.calibration.bases import SeenBase
from surg_perception.calibration.handeye import HandEyeFit, HandEyeProblem
from surg_perception.calibration.intrinsics import SeenCorners
from surg_perception.calibration.stereo import PairProblem, StereoFit
from surg_perception.calibration.triangulation import Stereo

SIZE = (640, 480)
LENS = LensModel("plumb_bob", SIZE, np.array([450.0, 450.0, 319.5, 239.5, 0, 0, 0, 0, 0]))


def eyes(baseline: float = 0.004) -> Stereo:
    """Two pinholes side by side."""
    X_LR = np.eye(4)
    X_LR[0, 3] = baseline
    return Stereo(LENS, LENS, X_LR)


def reaching(out: float) -> SeenCorners:
    """One corner in each quarter of the picture, ``out`` half heights from its middle."""
    diagonal = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]]) / np.sqrt(2.0)
    middle = (np.array(SIZE) - 1.0) / 2.0
    return SeenCorners(np.zeros((4, 3)), middle + out * 240.0 * diagonal)


def stereo(
    *,
    views: int = 12,
    left: float = 0.95,
    right: float = 0.95,
    baseline: float = 0.004,
    **rest: Any,
) -> StereoFit:
    """Corners that reach so many half heights in each eye; ``rest`` are fields of the fit."""
    seen = [(reaching(left), reaching(right))] * views
    problem = PairProblem(eyes(baseline), [np.eye(4)] * views, seen)
    none = [np.zeros(16)] * views
    fit = Adjusted(problem, np.zeros((views, 24, 24)), np.zeros((views, 24)), none)
    values = {"held_out": 0.1, "rows": 0.1, "errors": np.full(9, 1e-4)} | rest
    return StereoFit(fit, {}, distances=np.full(9, 0.08), left_out=0, **values)


def base(
    *, turn: float = 0.0, shift: float = 0.0, n: int = 16, patch: float = 0.01, by_eye: float = 0.0
) -> SeenBase:
    """Expected turn [rad] and shift amid the points [m]; ``by_eye`` is the share of the camera."""
    covariance = np.zeros((6, 6))
    covariance[0, 0], covariance[3, 3] = turn**2, shift**2
    points = np.zeros((n, 3))
    return SeenBase(
        X_ST=np.eye(4),
        covariance=covariance,
        handeye_covariance=by_eye**2 * covariance,
        rms=1e-4,
        n=n,
        p_S=points,
        residuals=points,
        X_SV=np.eye(4),
        spread=np.array([0.03, patch, 0.0]),
        middle=np.zeros(3),
    )


def handeye(
    *,
    views: int = 10,
    turns: tuple[float, float] = (40.0, 30.0),
    rms: float = 0.1,
    turn: float = 0.0,
    shift: float = 0.0,
    factor: float = 0.0,
    sd: float = 0.0,
) -> HandEyeFit:
    """Turns in degrees, expected errors in rad and m, ``factor`` the logarithm of both factors."""
    none = SeenCorners(np.zeros((0, 3)), np.zeros((0, 2)))
    X = np.eye(4)
    problem = HandEyeProblem(eyes(), X, X, np.array([X] * views), [(none, none)] * views)
    # Two opposite steps: the jackknife's covariance is (n - 1) / n * 2 g g^T with a unit normal.
    normal = np.zeros((views, 12, 12))
    normal[:] = np.eye(12)
    gradient = np.zeros((views, 12))
    gradient[0, 0], gradient[0, 3] = turn, shift
    gradient[1] = -gradient[0]
    gradient *= (views - 1) / np.sqrt(2 * (views - 1) / views)
    residuals = [np.full(8, rms / np.sqrt(2.0))] * views
    fit = Adjusted(problem, normal, gradient, residuals)
    return HandEyeFit(fit, np.exp([factor, 0.0]), np.array([sd, sd]), np.radians(turns))
