"""Metrics against closed forms, published values and invariances."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

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
    assert sparc(speed, 5.0) == sparc(speed, 5.0, fc=2.5) == sparc(speed, 5.0, fc=10.0)


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
    with pytest.raises(ValueError, match="fs is 0"):
        ldlj(np.ones(9), 0.0)


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


# --- oracles ---


def ldlj_written_out(v: np.ndarray, fs: float) -> float:
    """The definition in SI units, sample by sample: −ln( T³/v_peak² ∑ |jerk|² Δt )."""
    v = np.atleast_2d(v.T).T
    dt, n = 1.0 / fs, len(v)
    peak = max(math.sqrt(sum(x * x for x in row)) for row in v)
    integral = 0.0
    for k in range(1, n - 1):
        for d in range(v.shape[1]):
            jerk = (v[k + 1, d] - 2.0 * v[k, d] + v[k - 1, d]) / dt**2
            integral += jerk * jerk * dt
    return -math.log((n * dt) ** 3 / peak**2 * integral)


def test_ldlj_against_a_second_implementation(full: bool) -> None:
    rng, cases = np.random.default_rng(21), 500 if full else 60
    for case in range(cases):
        shape = (int(rng.integers(3, 80)), 3) if case % 2 else (int(rng.integers(3, 80)),)
        v, fs = np.cumsum(rng.normal(size=shape), axis=0), 10 ** rng.uniform(0, 3)
        assert ldlj(v, fs) == pytest.approx(ldlj_written_out(v, fs), abs=1e-9)
    print(f"{cases} motions")


def test_presets_against_their_definitions_written_out() -> None:
    fs, step = 30.0, 6
    rng = np.random.default_rng(22)
    t = np.arange(0, 40, 1 / fs)
    p = 0.02 * np.stack([np.sin(0.9 * t), np.sin(1.7 * t), np.cos(0.4 * t)], axis=1)
    p = p + 0.1e-3 * rng.normal(size=p.shape)

    slow = p[::step]
    speed = np.linalg.norm(np.gradient(slow, 0.2, axis=0), axis=1)
    jerk = np.diff(slow, n=3, axis=0) / 0.2**3
    reach = max(np.linalg.norm(row - slow[0]) for row in slow)
    duration = 0.2 * len(slow)
    by_hand = -math.log(duration**5 / reach**2 * np.sum(jerk**2) * 0.2)
    paper = metrics.smoothness(p, fs, "paper")
    assert paper.ldlj == pytest.approx(by_hand, abs=1e-9)
    assert paper.sparc == pytest.approx(reference_sparc(speed, 5.0, 0, 2.5), rel=1e-9)

    velocity = np.gradient(p, 1 / fs, axis=0)
    sections = signal.butter(8, 2.0, fs=fs, output="sos")
    velocity = signal.sosfiltfilt(sections, velocity, axis=0)[::step]
    published = metrics.smoothness(p, fs, "reference")
    speed = np.linalg.norm(velocity, axis=1)
    # The ends of the filter are padded a little differently: the last digits differ.
    assert published.ldlj == pytest.approx(ldlj_written_out(velocity, 5.0), abs=0.02)
    assert published.sparc == pytest.approx(reference_sparc(speed, 5.0, 4, 2.5), abs=0.02)
    assert abs(paper.ldlj - published.ldlj) > 1.0  # two metrics of one name


# --- invariances ---


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_presets_do_not_see_frame_size_or_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = np.cumsum(rng.normal(size=(600, 3)), axis=0) * 1e-3
    moved = float(rng.uniform(0.1, 10)) * p @ rotation(rng).T + rng.normal(size=3)
    for preset in metrics.PRESETS:
        one, two = metrics.smoothness(p, 30.0, preset), metrics.smoothness(moved, 30.0, preset)
        assert one.sparc == pytest.approx(two.sparc, abs=1e-6)
        assert one.ldlj == pytest.approx(two.ldlj, abs=1e-6)


@pytest.mark.parametrize("n", [3, 4, 10, 151])
def test_the_lower_bounds_are_reached_by_the_jerkiest_motion(n: int) -> None:
    back_and_forth = np.where(np.arange(n) % 2, 1.0, -1.0)
    bound = -math.log(16.0 * n**3 * (n - 2))
    assert ldlj(np.outer(back_and_forth, [2.0, 1.0, -2.0]), 5.0) == pytest.approx(bound, abs=1e-9)
    stop_and_go = (1.0 + back_and_forth) / 2
    assert ldlj(stop_and_go, 5.0) == pytest.approx(-math.log(4.0 * n**3 * (n - 2)), abs=1e-9)


def test_smoother_is_closer_to_zero() -> None:
    rng = np.random.default_rng(24)
    t = np.arange(0, 30, 1 / 500)
    p = 0.02 * np.stack([np.sin(0.9 * t), np.sin(1.1 * t), np.cos(0.4 * t)], axis=1)
    noise = metrics.low_pass(rng.normal(size=p.shape), 500.0, 1.5)
    for preset in metrics.PRESETS:
        clean, shaken = (metrics.smoothness(p + k * noise, 500.0, preset) for k in (0.0, 0.05))
        assert clean.sparc > shaken.sparc + 0.5
        assert clean.ldlj > shaken.ldlj + 1.0


# --- what real recordings are like ---


@pytest.mark.parametrize("preset", list(metrics.PRESETS))
@pytest.mark.parametrize("count", [0, 1, 2, 100, 250, 301])
def test_short_motions_are_nan_or_a_number_never_an_accident(preset: str, count: int) -> None:
    rng = np.random.default_rng(count)
    p = np.cumsum(rng.normal(size=(count, 3)), axis=0) * 1e-4
    found = metrics.smoothness(p, 500.0, preset)
    assert found.samples == (0 if count == 0 else (count - 1) // 100 + 1)
    if found.samples < 3:
        assert math.isnan(found.ldlj)
    if found.samples < 2:
        assert math.isnan(found.sparc)
    assert metrics.idle(p, 500.0).seconds <= count / 500


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_gap_in_the_numbers_is_refused_with_its_place(bad: float) -> None:
    p = np.ones((300, 3))
    p[17, 2] = bad
    for call in (
        lambda: metrics.smoothness(p, 500.0),
        lambda: metrics.smoothness(p, 500.0, "paper"),
        lambda: metrics.idle(p, 500.0),
        lambda: ldlj(p, 500.0),
        lambda: metrics.ldlj_displacement(p, 500.0),
    ):
        with pytest.raises(ValueError, match=r"not finite at index \(17, 2\)"):
            call()
    with pytest.raises(ValueError, match=r"speed is not finite at index \(17,\)"):
        sparc(p[:, 2], 500.0)
    assert np.count_nonzero(np.isnan(rcm_deviation(p, p, np.zeros(3)))) == 1


def test_a_rate_below_the_preset_s_is_refused() -> None:
    for preset in metrics.PRESETS:
        with pytest.raises(ValueError, match="4 Hz cannot be brought to 5 Hz"):
            metrics.smoothness(np.random.default_rng(0).normal(size=(50, 3)), 4.0, preset)
    with pytest.raises(ValueError, match=r"no smoothness preset 'mine'.*paper.*reference"):
        metrics.smoothness(np.zeros((50, 3)), 500.0, "mine")


# --- idle time ---


def test_idle_time_counts_pauses_and_not_turning_points() -> None:
    fs = 500.0
    speeds = [(2.0, 0.03), (1.5, 0.0), (3.0, -0.02), (0.3, 0.0), (2.0, 0.03), (4.0, 0.0)]
    x = np.cumsum(np.concatenate([np.full(round(t * fs), v / fs) for t, v in speeds]))
    tremor = 0.05e-3 * np.sin(2 * np.pi * 10 * np.arange(len(x)) / fs)
    p = np.stack([x, tremor, 0 * x], axis=1)
    found = metrics.idle(p, fs)
    print(found)
    # Two pauses count. The filter blurs each of their three inner ends by about 0.2 s.
    assert found.pauses == 2
    assert 5.5 - 3 * 0.25 < found.seconds < 5.5
    assert found.share == pytest.approx(found.seconds / 12.8, rel=1e-3)
    still = metrics.idle(np.ones((1001, 3)), fs)
    assert (still.seconds, still.share, still.pauses) == (2.0, 1.0, 1)


def test_idle_time_is_that_of_the_definition(full: bool) -> None:
    rng, cases = np.random.default_rng(25), 200 if full else 30
    for _ in range(cases):
        fs = float(rng.integers(20, 60))
        p = np.cumsum(rng.normal(size=(400, 3)) * (rng.random((400, 1)) < 0.02), axis=0) * 1e-2
        slow = metrics.low_pass(p, fs, 3.0)
        speed = [float(np.linalg.norm(b - a)) * fs for a, b in itertools.pairwise(slow)]
        runs = [
            len(list(run)) for still, run in itertools.groupby(v < 1e-3 for v in speed) if still
        ]
        counted = [run / fs for run in runs if run / fs >= 0.5 - 0.5 / fs]
        found = metrics.idle(p, fs)
        assert (found.seconds, found.pauses) == (pytest.approx(sum(counted)), len(counted))
    print(f"{cases} motions")


@pytest.mark.parametrize("name", ["fs", "cutoff"])
def test_idle_time_refuses_nonsense(name: str) -> None:
    given = {"fs": 500.0, name: 0.0}
    with pytest.raises(ValueError, match=f"idle: {name} is 0"):
        metrics.idle(np.zeros((10, 3)), **given)
