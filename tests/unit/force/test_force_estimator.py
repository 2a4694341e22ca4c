"""The estimate of a stream: inertia, noise, its own interval, and when it has no answer."""

import dataclasses

import numpy as np
import pytest

from helpers.force.statics import Array, Situation, drawn, turn
from surg_core.force import estimator as estimators
from surg_core.force.compensation import ToolLoad
from surg_core.force.estimator import ForceEstimate, ForceEstimator
from surg_core.force.sensor_file import ForceSensor

PERIOD = 0.002
NOISE = np.array([0.05, 0.05, 0.05, 0.001, 0.001, 0.001])


def sensor(noise: Array = NOISE) -> ForceSensor:
    return ForceSensor(
        "test", 1.0 / PERIOD, np.array([200.0] * 3 + [8.0] * 3), noise, np.zeros(6), 1.0, False,
        np.eye(4), np.zeros(6), np.zeros(3),
    )  # fmt: skip


def estimator(case: Situation, covariance: Array | None = None) -> ForceEstimator:
    load = ToolLoad(
        case.mass, case.p_SCom, case.bias, case.R_FS, case.p_FS,
        np.zeros((13, 13)) if covariance is None else covariance,
    )  # fmt: skip
    return ForceEstimator(load, sensor(), case.s_F, case.p_FTip, case.g)


def update(it: ForceEstimator, *state: object) -> ForceEstimate:
    it.add(*state)  # type: ignore[arg-type]
    return it.estimate()


def fed(it: ForceEstimator, case: Situation, n: int, noise: Array | None = None) -> ForceEstimate:
    """The estimate after n readings of an arm at rest; noise (n, 6)."""
    for k in range(n):
        reading = case.reading() + (0.0 if noise is None else noise[k])
        out = update(it, k * PERIOD, reading, case.X_BF, np.zeros(6), case.p_Rcm)
    return out


def bounded(rng: np.random.Generator, depth: float) -> Situation:
    """A situation at a depth, with 5 N at the tip."""
    case = dataclasses.replace(drawn(rng), depth=depth)
    case.tip *= 5.0 / np.linalg.norm(case.tip)
    return case


def test_an_estimate_needs_a_full_window_and_belongs_to_its_middle() -> None:
    case = bounded(np.random.default_rng(5), 0.1)
    it = estimator(case)
    n = round(estimators.WINDOW / PERIOD)
    assert fed(it, case, n - 1).reason == estimators.FILLING
    out = update(it, (n - 1) * PERIOD, case.reading(), case.X_BF, np.zeros(6), case.p_Rcm)
    assert out.valid
    assert out.stamp == pytest.approx(0.5 * (n - 1) * PERIOD)
    assert out.forces is not None
    np.testing.assert_allclose(out.forces.tip, case.across(case.tip), atol=1e-9)


def test_a_gap_empties_the_window() -> None:
    case = bounded(np.random.default_rng(6), 0.1)
    it = estimator(case)
    last = 20
    assert fed(it, case, last).valid
    late = (last + 3) * PERIOD
    assert update(it, late, case.reading(), case.X_BF, np.zeros(6), case.p_Rcm).reason == "filling"


@pytest.mark.parametrize("seed", range(5))
def test_the_inertia_of_a_swinging_tool_is_no_force(seed: int) -> None:
    """A point mass on an arm that turns and moves: Newton's law by differences of its place."""
    rng = np.random.default_rng(seed)
    case = bounded(rng, 0.1)
    case.tip, case.trocar = np.zeros(3), np.zeros(3)
    it, h = estimator(case), 1e-4
    axis, away = rng.normal(size=3), rng.normal(size=3)
    X_0 = case.X_BF

    def pose(t: float) -> Array:
        X = np.eye(4)
        X[:3, :3] = turn(0.05 * np.sin(6.0 * t) * axis) @ X_0[:3, :3]
        X[:3, 3] = X_0[:3, 3] + 0.02 * np.sin(5.0 * t) * away
        return X

    p_FCom = np.append(case.p_FS + case.R_FS @ case.p_SCom, 1.0)
    for k in range(12):
        t = 0.15 + k * PERIOD
        X = pose(t)
        a = ((pose(t + h) - 2 * X + pose(t - h)) @ p_FCom)[:3] / h**2
        still = dataclasses.replace(case, X_BF=X, g=case.g - a)
        W = (pose(t + h)[:3, :3] - pose(t - h)[:3, :3]) / (2 * h) @ X[:3, :3].T
        omega = np.array([W[2, 1], W[0, 2], W[1, 0]])
        v = (pose(t + h) - pose(t - h))[:3, 3] / (2 * h)
        out = update(it, t, still.reading(), X, np.concatenate([v, omega]), still.p_Rcm)
    felt = np.linalg.norm(still.mass * (still.g - case.g))
    assert felt > 0.05
    assert out.forces is not None and out.total is not None
    assert np.linalg.norm(out.forces.tip) < 0.05 * felt + 0.005
    assert np.linalg.norm(out.total) < 0.02 * felt


def test_the_covariance_holds_what_noise_load_and_trocar_make_of_the_estimate() -> None:
    """Normalised squared errors of (tip, trocar) are chi-squared with four degrees of freedom."""
    rng = np.random.default_rng(8)
    scale = np.diag([0.01, *[0.001] * 3, *[0.02] * 3, *[0.001] * 3, *[0.002] * 3])
    squared = []
    for _ in range(200):
        case = bounded(rng, rng.uniform(0.03, 0.12))
        it = estimator(case, scale**2)
        wrong = scale @ rng.normal(size=13)
        load = it.load
        it.load = ToolLoad(
            load.mass + wrong[0], load.p_SCom + wrong[1:4], load.bias + wrong[4:10],
            load.R_FS @ turn(wrong[10:]), load.p_FS, scale**2,
        )  # fmt: skip
        beside = case.across(estimators.SHAFT_SD * rng.normal(size=3))
        p_FTip = case.p_FTip + case.X_BF[:3, :3].T @ beside
        true = dataclasses.replace(case, p_FTip=p_FTip).reading()
        n = round(estimators.WINDOW / PERIOD)
        deeper = estimators.DEPTH_SD * rng.normal() * case.s
        for k in range(n):
            reading = true + NOISE * rng.normal(size=6)
            twist = np.concatenate([estimators.VELOCITY_SD * rng.normal(size=3), np.zeros(3)])
            out = update(it, k * PERIOD, reading, case.X_BF, twist, case.p_Rcm + deeper)
        assert out.forces is not None and out.covariance is not None
        late = (estimators.LOAD_RATE * 0.5 * (n - 1) * PERIOD) ** 2
        C = out.covariance.copy()
        P = np.eye(3) - np.outer(case.s, case.s)
        C[:3, :3] -= late * P  # nothing changes here, so the window's age is no error
        C[3:6, 3:6] -= late * P
        e = np.concatenate([out.forces.tip - case.across(case.tip),
                            out.forces.trocar - case.across(case.trocar)])  # fmt: skip
        squared.append(e @ np.linalg.pinv(C[:6, :6], rcond=1e-6) @ e)
    inside = np.mean(np.array(squared) < 9.488)  # 95 % of chi-squared with 4
    print(f"mean of {np.mean(squared):.2f} (4 is right), inside 95 %: {inside:.3f}")
    assert 3.4 < np.mean(squared) < 4.6
    assert 0.92 < inside < 0.98


def test_near_the_trocar_the_estimate_says_so_and_still_has_the_sum() -> None:
    rng = np.random.default_rng(9)
    for depth in (0.02, 0.009, 0.0, -0.05):
        case = bounded(rng, 0.1)
        case.trocar *= 0.0
        case.depth = depth
        noisy = estimator(case)
        noisy.sensor = sensor(4.0 * NOISE)
        out = fed(noisy, case, 10)
        assert (out.reason, out.valid) == (estimators.NEAR_TROCAR, False)
        assert out.total is not None
        np.testing.assert_allclose(out.total, case.tip, atol=1e-9)


@pytest.mark.parametrize(
    ("component", "value", "reason"),
    [(2, 200.0, "saturated"), (5, -9.0, "saturated"), (0, np.nan, "not_finite"),
     (4, np.inf, "not_finite")],
)  # fmt: skip
def test_a_reading_out_of_range_is_named_and_empties_the_window(
    component: int, value: float, reason: str
) -> None:
    case = bounded(np.random.default_rng(10), 0.1)
    it = estimator(case)
    assert fed(it, case, 10).valid
    bad = case.reading()
    bad[component] = value
    assert update(it, 0.02, bad, case.X_BF, np.zeros(6), case.p_Rcm).reason == reason
    assert update(it, 0.022, case.reading(), case.X_BF, np.zeros(6), case.p_Rcm).reason == "filling"
