"""The lens models agree with OpenCV's, their derivatives with finite differences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from surg_core.pictures.lens_model import LensModel
from surg_core.transforms import rotation_of
from surg_perception.calibration.board import Board
from surg_perception.calibration.intrinsics import SeenCorners, choose_model
from surg_perception.calibration.small_motions import transform

LENSES = {
    "plumb_bob": [-0.3, 0.1, 0.001, -0.002, 0.05],
    "rational_polynomial": [-0.3, 0.1, 0.001, -0.002, 0.05, 0.02, 0.03, 0.01],
    "equidistant": [-0.05, 0.02, 0.01, 0.003],
}


def points() -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.normal(size=(40, 3)) * [0.03, 0.02, 0.01] + [0.0, 0.0, 0.08]


def lens(model: str) -> LensModel:
    return LensModel(model, (640, 480), np.array([500.0, 505.0, 320.0, 241.0, *LENSES[model]]))


@pytest.mark.parametrize("model", LENSES)
def test_a_lens_projects_as_opencv_does(model: str) -> None:
    made, zero = lens(model), np.zeros(3)
    if model == "equidistant":
        expected, _ = cv2.fisheye.projectPoints(points()[:, None], zero, zero, made.K, made.D)
    else:
        expected, _ = cv2.projectPoints(points(), zero, zero, made.K, made.D)
    np.testing.assert_allclose(made.project(points()), expected.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("model", LENSES)
def test_derivatives_are_finite_differences(model: str) -> None:
    made, p = lens(model), points()
    _, by_point, by_values = made.derivatives(p)
    for axis in range(3):
        step = 1e-7 * np.eye(3)[axis]
        slope = (made.project(p + step) - made.project(p - step)) / 2e-7
        np.testing.assert_allclose(by_point[..., axis], slope, rtol=1e-5, atol=1e-3)
    for k, step in enumerate(1e-6 * np.eye(len(made.values))):
        slope = (made.moved(step).project(p) - made.moved(-step).project(p)) / 2e-6
        np.testing.assert_allclose(by_values[..., k], slope, atol=1e-6)


@pytest.mark.parametrize("model", LENSES)
def test_rays_are_the_inverse_of_the_projection(model: str) -> None:
    p = points()
    rays = lens(model).rays(lens(model).project(p))
    np.testing.assert_allclose(rays, p / p[:, 2:], atol=1e-12)


def test_a_pixel_beyond_the_range_of_a_lens_has_no_ray() -> None:
    assert np.isnan(lens("plumb_bob").rays(np.array([[4000.0, 3000.0]]))[0, :2]).any()


def shown(made: LensModel, rng: np.random.Generator, views: int = 12) -> list[SeenCorners]:
    """Corners of a board that goes round the picture, with 0.05 px of noise."""
    board, found = Board(), []
    middle = np.append(np.array(board.size) / 2.0, 0.0)
    for number in range(views):
        X, angle = np.eye(4), np.pi * (0.25 + 0.5 * number)
        X[:3, :3] = rotation_of(rng.uniform(-0.4, 0.4, 3)) @ np.diag([1.0, -1.0, -1.0])
        z = rng.uniform(0.035, 0.06)
        beside = [0.6 * z * np.cos(angle), 0.45 * z * np.sin(angle), z]
        X[:3, 3] = beside - X[:3, :3] @ middle
        pixels = made.project(transform(X, board.corners))
        pixels += rng.normal(scale=0.05, size=pixels.shape)
        inside = ((pixels > 3) & (pixels < np.array(made.size) - 4)).all(axis=1)
        found.append(SeenCorners(board.corners[inside], pixels[inside]))
    return found


@pytest.mark.parametrize(
    ("model", "f", "D"),
    [("equidistant", 280.0, [0.0] * 4), ("plumb_bob", 455.0, [-0.3, 0.08, 0.0, 0.0, 0.0])],
)
def test_the_simplest_model_that_predicts_unseen_views_is_chosen(
    model: str, f: float, D: list[float]
) -> None:
    made = LensModel(model, (640, 480), np.array([f, f, 320.0, 240.0, *D]))
    chosen, errors = choose_model([shown(made, np.random.default_rng(1))], made.size)
    print(f"{model}: held out {errors}")
    assert chosen == model
    assert errors[model] <= 0.1
