"""Metrics against closed forms, published values and invariances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surg_recording import metrics
from surg_recording.metrics import ldlj, rcm_deviation, sparc


def published_example(fs: float = 100.0) -> np.ndarray:
    return np.exp(-5.0 * np.arange(-1.0, 1.0, 1.0 / fs) ** 2)


def reference_sparc(speed: np.ndarray, fs: float, padlevel: int = 4, fc: float = 10.0) -> float:
    """Written down from the definition a second time, sample by sample."""
    n = 2 ** (math.ceil(math.log2(len(speed))) + padlevel)
    spectrum = np.abs([np.sum(speed * np.exp(-2j * np.pi * k * np.arange(len(speed)) / n))
                       for k in range(math.floor(fc * n / fs) + 1)])  # fmt: skip
    whole = np.max(np.abs(np.fft.fft(speed, n)))
    amplitude = spectrum / whole
    last = max(k for k, a in enumerate(amplitude) if a >= 0.05)
    first = min(k for k, a in enumerate(amplitude) if a >= 0.05)
    arc = 0.0
    for k in range(first, last):
        arc += math.sqrt((1 / (last - first)) ** 2 + (amplitude[k + 1] - amplitude[k]) ** 2)
    return -arc


def rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


# --- rcm deviation ---


def test_rcm_deviation_is_the_lateral_offset_by_construction() -> None:
    rng, count = np.random.default_rng(1), 1000
    s = rng.normal(size=(count, 3))
    side = np.cross(s, rng.normal(size=(count, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    distance = 10.0 ** rng.uniform(-7, -1, count)
    pivot = rng.normal(size=(count, 3))
    point = pivot + side * distance[:, None] + s * rng.uniform(-2, 2, (count, 1))
    got = rcm_deviation(point, s, pivot)
    assert np.max(np.abs(got - distance)) < 1e-14
    print(f"{count} lines")


def test_rcm_deviation_does_not_depend_on_the_point_or_the_axis_length() -> None:
    rng = np.random.default_rng(2)
    p, s, c = (rng.normal(size=(200, 3)) for _ in range(3))
    length = rng.uniform(-9, 9, (200, 1))
    assert np.allclose(rcm_deviation(p, s, c), rcm_deviation(p + s * length, s * length, c))
    assert rcm_deviation(p, s, c[0]).shape == (200,)


def test_rcm_deviation_of_a_directionless_shaft_is_nan() -> None:
    assert math.isnan(rcm_deviation([[0, 0, 1]], [[0, 0, 0]], [[0, 0, 0]])[0])
    with pytest.raises(ValueError, match=r"p_BShaft has shape \(3,\)"):
        rcm_deviation([0, 0, 1], [[0, 0, 1]], [[0, 0, 0]])
    with pytest.raises(ValueError, match="differ"):
        rcm_deviation(np.zeros((2, 3)), np.ones((3, 3)), np.zeros((2, 3)))


# --- smoothness ---


def test_published_values() -> None:
    assert sparc(published_example(), 100.0) == pytest.approx(-1.41403, abs=5e-6)
    assert ldlj(published_example(), 100.0) == pytest.approx(-5.81636, abs=5e-6)


def test_sparc_against_a_second_implementation() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        n = int(rng.integers(20, 120))
        speed = np.abs(np.cumsum(rng.normal(size=n)))
        fs = float(rng.uniform(21, 200))
        assert sparc(speed, fs) == pytest.approx(reference_sparc(speed, fs), rel=1e-9)


def test_sparc_at_5_hz_does_not_count_the_mirror_image() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(0, 30, 0.2)
    speed = np.abs(np.sin(0.7 * t) + 0.1 * rng.normal(size=t.size))
    guarded = sparc(speed, 5.0)
    assert guarded == sparc(speed, 5.0, fc=2.5) == sparc(speed, 5.0, fc=10.0)
    doubled = sparc(speed, 5.0, fc=10.0, mirrored=True)
    assert doubled < 1.7 * guarded, (doubled, guarded)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_short_is_nan(n: int) -> None:
    assert math.isnan(ldlj(np.ones(n), 5.0))
    assert n == 2 or math.isnan(sparc(np.ones(n), 5.0))


def test_no_motion_is_nan() -> None:
    assert math.isnan(sparc(np.zeros(50), 5.0))
    assert math.isnan(ldlj(np.zeros(50), 5.0))
    assert math.isnan(ldlj(np.zeros((50, 3)), 5.0))
    assert math.isnan(metrics.ldlj_displacement(np.ones((50, 3)), 5.0))
    still = metrics.smoothness(np.ones((500, 3)), 500.0)
    assert math.isnan(still.sparc)
    assert math.isnan(still.ldlj)


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match=r"not finite at index \(3,\)"):
        sparc([0, 1, 2, math.nan], 5.0)
    with pytest.raises(ValueError, match="fs is 0"):
        ldlj(np.ones(9), 0.0)
    with pytest.raises(ValueError, match="no smoothness preset"):
        metrics.smoothness(np.ones((9, 3)), 5.0, "best")
    with pytest.raises(ValueError, match="cannot be brought to"):
        metrics.smoothness(np.ones((9, 3)), 2.0)


speeds = st.lists(st.floats(0.0, 10.0), min_size=8, max_size=60).filter(lambda v: np.ptp(v) > 1e-3)


@settings(max_examples=60, deadline=None)
@given(speeds, st.floats(1e-3, 1e3), st.floats(1.0, 500.0))
def test_invariances(speed: list[float], gain: float, fs: float) -> None:
    v = np.array(speed)
    # neither the unit of the speed nor, for LDLJ, the rate matters
    assert ldlj(gain * v, fs) == pytest.approx(ldlj(v, 7.0), abs=1e-9)
    assert sparc(gain * v, fs) == pytest.approx(sparc(v, fs), abs=1e-6)
    # bounds
    n = len(v)
    assert ldlj(v, fs) >= -math.log(4.0 * n**3 * (n - 2)) - 1e-9
    assert sparc(v, fs) <= 0.0


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_the_vector_form_is_frame_free_and_bounded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    v = rng.normal(size=(int(rng.integers(4, 60)), 3))
    turned = v @ rotation(rng).T
    assert ldlj(turned, 5.0) == pytest.approx(ldlj(v, 5.0), abs=1e-9)
    n = len(v)
    assert ldlj(v, 5.0) >= -math.log(16.0 * n**3 * (n - 2)) - 1e-9
    p = np.cumsum(v, axis=0)
    moved = p @ rotation(rng).T + rng.normal(size=3)
    a, b = metrics.ldlj_displacement(p, 5.0), metrics.ldlj_displacement(moved, 5.0)
    assert a == pytest.approx(b, abs=1e-8)


def test_ldlj_of_a_parabola_in_closed_form() -> None:
    # v = k (N-1-k): the second difference is -2 everywhere, the peak ((N-1)/2)^2 for odd N
    n = 51
    k = np.arange(n)
    expected = -math.log(n**3 * (n - 2) * 4.0 / ((n - 1) / 2) ** 4)
    assert ldlj(k * (n - 1 - k), 5.0) == pytest.approx(expected, abs=1e-12)


def test_ldlj_displacement_of_a_cubic_in_closed_form() -> None:
    n = 40
    k = np.arange(n, dtype=float)
    p = np.stack([k**3, 0 * k, 0 * k], axis=1)
    expected = -math.log(n**5 * (n - 3) * 36.0 / (n - 1) ** 6)
    assert metrics.ldlj_displacement(p, 3.0) == pytest.approx(expected, abs=1e-10)


def test_presets_state_every_parameter() -> None:
    for name, preset in metrics.PRESETS.items():
        assert preset.name == name
        assert set(preset.parameters()) >= {"fs", "downsampling", "sparc_fc", "sparc_padlevel"}
        assert name in preset.label()


def test_downsampling_lets_no_tremor_alias() -> None:
    fs, t = 500.0, np.arange(0, 20, 0.002)
    slow = np.stack([0.01 * np.cos(2 * np.pi * 0.5 * t)] * 3, axis=1)
    tremor = 0.02 * np.sin(2 * np.pi * 9.0 * t)[:, None]
    clean, shaken = (metrics.downsample(v, fs, 5.0) for v in (slow, slow + tremor))
    inner = slice(10, -10)
    assert np.max(np.abs(shaken - clean)[inner]) < 1e-6
    assert np.max(np.abs(clean - slow[::100])[inner]) < 1e-4
    strided = metrics.stride(slow + tremor, fs, 5.0)
    assert np.array_equal(strided, (slow + tremor)[::100])


# --- path, sweep, tracking ---


def test_path_length_of_a_circle_with_and_without_tremor() -> None:
    fs, t = 500.0, np.arange(0, 10.001, 0.002)
    circle = 0.03 * np.stack([np.cos(0.8 * t), np.sin(0.8 * t), 0 * t], axis=1)
    exact = 0.03 * 0.8 * t[-1]
    tremor = 0.1e-3 * np.sin(2 * np.pi * 10 * t)[:, None] * np.array([1.0, 0.5, -1.0])
    assert metrics.path_length(circle) == pytest.approx(exact, rel=1e-6)
    assert metrics.path_length(circle + tremor) > 1.02 * exact
    assert metrics.path_length(circle + tremor, fs, 3.0) == pytest.approx(exact, rel=2e-3)


def test_low_pass_has_no_phase_and_6_db_at_the_cutoff() -> None:
    t = np.arange(0, 20, 0.002)
    wave = np.sin(2 * np.pi * 3.0 * t)
    middle = slice(2000, -2000)
    assert np.allclose(metrics.low_pass(wave, 500.0, 3.0)[middle], 0.5 * wave[middle], atol=2e-3)
    assert metrics.low_pass(np.ones((3, 2)), 500.0, 3.0).shape == (3, 2)


def test_shaft_sweep_against_all_pairs(full: bool) -> None:
    rng = np.random.default_rng(5)
    cases = 300 if full else 40
    for case in range(cases):
        width = rng.uniform(0.01, 1.2) if case % 4 else 3.0
        s = rng.normal(size=(int(rng.integers(2, 200)), 3)) * width + [0, 0, 1]
        s /= np.linalg.norm(s, axis=1, keepdims=True)
        s = s @ rotation(rng).T
        all_pairs = np.arccos(np.clip(s @ s.T, -1, 1)).max()
        assert metrics.shaft_sweep(s) == pytest.approx(all_pairs, abs=1e-7)
    print(f"{cases} bundles")


def test_shaft_sweep_of_plane_and_constant_bundles() -> None:
    angle = np.linspace(-0.3, 0.4, 101)
    fan = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    assert metrics.shaft_sweep(fan) == pytest.approx(0.7, abs=1e-12)
    assert metrics.shaft_sweep(np.tile([0.0, 0.0, 1.0], (50, 1))) == 0.0
    assert metrics.shaft_sweep(np.array([[0.0, 0.0, 1.0]])) == 0.0


@pytest.mark.parametrize("lag", [-0.01, 0.0, 0.0031, 0.0124, 0.3])
def test_tracking_finds_lag_and_error(lag: float) -> None:
    def wave(t: np.ndarray) -> np.ndarray:
        return 0.03 * np.stack([np.sin(2 * t), np.cos(1.3 * t), 0 * t], axis=1)

    t = np.arange(0, 12, 0.002)
    exact = metrics.tracking(t, wave(t - lag), t, wave(t))
    assert exact.lag == pytest.approx(lag, abs=2e-6)
    assert exact.max < 1e-6
    # An offset across the motion is not explained by any shift: it is the error.
    found = metrics.tracking(t, wave(t - lag) + np.array([0.0, 0.0, 0.4e-3]), t, wave(t))
    assert found.lag == pytest.approx(lag, abs=2e-6)
    assert found.rms == pytest.approx(0.4e-3, rel=1e-3)
    assert np.count_nonzero(np.isfinite(found.error)) >= len(t) - abs(lag) / 0.002 - 2


def test_tracking_of_a_30_hz_input_is_limited_by_its_chords_only() -> None:
    t, slow = np.arange(0, 10, 0.002), np.arange(0, 10.05, 1 / 30)

    def wave(t: np.ndarray) -> np.ndarray:
        return 0.03 * np.stack([np.sin(2 * t), np.cos(t), 0 * t], axis=1)

    found = metrics.tracking(t, wave(t - 0.02), slow, wave(slow))
    assert found.lag == pytest.approx(0.02, abs=2e-4)
    assert found.max < 0.03 * 4 * (1 / 30) ** 2 / 8 * 1.2


def test_tracking_refuses_what_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        metrics.tracking([0.0], np.zeros((1, 3)), [0.0, 1.0], np.zeros((2, 3)))
    with pytest.raises(ValueError, match="overlap"):
        metrics.tracking([0, 1], np.zeros((2, 3)), [50, 51], np.zeros((2, 3)))


def test_percentiles() -> None:
    assert metrics.percentiles(np.arange(101), 50, 99) == [50.0, 99.0]
    assert metrics.percentiles([math.nan, 3.0], 50) == [3.0]
    assert math.isnan(metrics.percentiles([], 50)[0])
