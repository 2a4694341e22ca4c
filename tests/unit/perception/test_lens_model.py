"""The lens models agree with OpenCV's, their derivatives with finite differences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from surg_perception.calibration.lens_model import LensModel

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
