"""The base of the second arm: exact points, and what the camera's error does to it."""

from __future__ import annotations

import numpy as np

from helpers.endoscope_files import covariance, pose
from surg_core.transforms import inverse_pose, rotation_of
from surg_perception.calibration.bases import SeenBase, solve_base, turn_by_strain
from surg_perception.calibration.small_motions import difference, moved, transform


def postures(rng: np.random.Generator, n: int) -> np.ndarray:
    """Flange poses (n, 4, 4) near one another, as of a scope in its trocar."""
    first = pose(rng)
    found = np.repeat(first[None], n, axis=0)
    for X in found:
        X[:3, :3] = rotation_of(rng.normal(scale=0.1, size=3)) @ X[:3, :3]
        X[:3, 3] += rng.normal(scale=0.01, size=3)
    return found


def solved(step: np.ndarray, C: np.ndarray) -> tuple[SeenBase, np.ndarray]:
    """The fit through a camera that is ``step`` (6,) off, and the true base (4, 4)."""
    rng = np.random.default_rng(2)
    X_ST, X_FV, X_SF = pose(rng), pose(rng, 0.4), postures(rng, 12)
    p_S = transform(X_SF[0] @ X_FV, rng.uniform(-0.03, 0.03, (12, 3)) + np.array([0, 0, 0.08]))
    p_T = transform(inverse_pose(X_ST), p_S)
    seen = [
        transform(X @ moved(X_FV, step) @ inverse_pose(X @ X_FV), p[None])[0]
        for X, p in zip(X_SF, p_S, strict=True)
    ]
    return solve_base(np.array(seen), p_T, X_SF, X_FV, C), X_ST


def test_exact_points_give_the_base() -> None:
    fit, X_ST = solved(np.zeros(6), np.zeros((6, 6)))
    np.testing.assert_allclose(fit.X_ST, X_ST, atol=1e-12)
    assert fit.rms < 1e-12 and fit.error[0] < 1e-9


def test_the_stated_error_holds_the_cameras() -> None:
    rng = np.random.default_rng(5)
    C = covariance(rng, turn=1e-3, shift=1e-4)
    fit, X_ST = solved(np.zeros(6), C)
    np.testing.assert_allclose(fit.covariance, fit.handeye_covariance, atol=1e-15)
    steps = rng.multivariate_normal(np.zeros(6), C, size=150)
    found = np.array([difference(solved(step, C)[0].X_ST, X_ST) for step in steps])
    drawn, stated = np.sqrt(np.diag(np.cov(found.T))), np.sqrt(np.diag(fit.covariance))
    print(f"drawn {drawn}, stated {stated}")
    np.testing.assert_allclose(drawn, stated, rtol=0.25)
    assert fit.camera_share > 0.99


def inside(smooth: bool, seeds: int = 200) -> tuple[int, float]:
    """How often 2.5 sigma hold the turn where the error is linear in the place, and the median."""
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        X_ST, X_FV, X_SF = pose(rng), pose(rng, 0.4), np.repeat(pose(rng)[None], 12, axis=0)
        p_S = rng.uniform(-0.018, 0.018, (12, 3)) + np.array([0.0, 0.0, 0.08])
        p_T = transform(inverse_pose(X_ST), p_S)
        wrong = p_S @ rng.normal(scale=0.01, size=(3, 3)) + rng.normal(scale=1e-4, size=(12, 3))
        fit = solve_base(p_S + wrong, p_T, X_SF, X_FV, 1e-12 * np.eye(6), smooth)
        turn_ = np.linalg.norm(difference(fit.X_ST, X_ST)[:3])
        found.append(turn_ / fit.error[0])
    return int((np.array(found) < 2.5).sum()), float(np.median(found))


def test_a_smooth_error_of_what_is_followed_is_stated() -> None:
    """Where the points' errors change smoothly, a jackknife over points alone states too little."""
    held, median = inside(smooth=True)
    alone, _ = inside(smooth=False)
    print(f"2.5 sigma hold in {held} of 200, median {median:.2f} sigma; jackknife alone {alone}")
    assert held >= 190 and median > 0.4
    assert alone < 150


def test_a_pure_turn_is_no_strain() -> None:
    rng = np.random.default_rng(1)
    p = rng.uniform(-0.02, 0.02, (20, 3))
    assert turn_by_strain(p, np.cross([0.01, 0.0, 0.0], p)) < 1e-12
    np.testing.assert_allclose(turn_by_strain(p, p * [0.01, 0.0, 0.0]), np.sqrt(1e-4 / 8))
