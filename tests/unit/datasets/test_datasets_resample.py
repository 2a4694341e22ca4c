"""The resampler against brute force, scipy and geometry."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from helpers.results.dataset_results import note
from surg_core.contract import SECOND_NS
from surg_recording.datasets.frames.resample import (
    Grid,
    linear,
    offsets_ns,
    previous,
    slerp,
)
from surg_recording.recording_errors import EpisodeError

GAP = 10 * SECOND_NS


def families(full: bool) -> range:
    """Seeds of one test."""
    count = 2000 if full else 40
    note("resampler against brute force, scipy, geometry", count, "all agree")
    return range(count)


def stamps_of(rng: np.random.Generator, n: int) -> np.ndarray:
    """Strictly increasing, irregular, large as wall clocks are."""
    return 1_795_249_117_000_000_000 + np.cumsum(rng.integers(1, 30_000_000, n))


def times_of(rng: np.random.Generator, stamps: np.ndarray, n: int) -> np.ndarray:
    """Grid times inside, some of them exactly on a sample."""
    inside = rng.integers(stamps[0], stamps[-1] + 1, n)
    return np.sort(np.concatenate([inside, rng.choice(stamps, 5), stamps[[0, -1]]]))


def test_grid_times_never_drift(full: bool) -> None:
    rng = np.random.default_rng(1)
    checked = 0
    for fps in (1, 7, 20, 24, 29, 30, 50, 60, 144, 1000):
        k = np.concatenate([np.arange(100), rng.integers(0, 10**8, 1000 if full else 100)])
        for frame, offset in zip(k.tolist(), offsets_ns(k, fps).tolist(), strict=True):
            assert abs(Fraction(frame * SECOND_NS, fps) - offset) <= Fraction(1, 2)
            checked += 1
    grid = Grid(10**18 + 7, 30, 1000)
    assert (grid.times_ns[1:] == grid.next_ns[:-1]).all()
    assert grid.times_ns[0] == 10**18 + 7
    assert (grid.timestamps == np.array([k / 30 for k in range(1000)])).all()
    note("grid times against exact fractions", checked, "all within half a nanosecond")


def test_previous_is_the_newest_that_is_not_later(full: bool) -> None:
    for seed in families(full):
        rng = np.random.default_rng(seed)
        stamps = stamps_of(rng, int(rng.integers(2, 80)))
        times = times_of(rng, stamps, 40)
        index = previous(stamps, times, "x")
        for time, found in zip(times, index, strict=True):
            assert found == max(i for i, stamp in enumerate(stamps) if stamp <= time)
        ages = times - stamps[index]
        assert (ages >= 0).all()
        oldest = int(ages.max())
        assert (previous(stamps, times, "x", oldest) == index).all()
        if oldest:
            with pytest.raises(EpisodeError, match=r"newest sample at frame \d+ .* ms old"):
                previous(stamps, times, "x", oldest - 1)
        with pytest.raises(EpisodeError, match="no sample at or before"):
            previous(stamps, times - (times[0] - stamps[0]) - 1, "x")


def test_linear_is_exact_for_straight_motion_and_stays_between_samples(full: bool) -> None:
    for seed in families(full):
        rng = np.random.default_rng(seed)
        stamps = stamps_of(rng, int(rng.integers(2, 80)))
        times = times_of(rng, stamps, 40)
        slope, at = rng.normal(size=3), rng.normal(size=3)
        straight = at + np.outer((stamps - stamps[0]) * 1e-9, slope)
        found, before = linear(stamps, straight, times, "x", GAP)
        expected = at + np.outer((times - stamps[0]) * 1e-9, slope)
        np.testing.assert_allclose(found, expected, atol=1e-12)
        assert (before == previous(stamps, times, "x")).all()

        any_values = rng.normal(size=(len(stamps), 2))
        found, before = linear(stamps, any_values, times, "x", GAP)
        on = np.isin(times, stamps)
        assert (found[on] == any_values[before[on]]).all(), "a sample's own value, bit by bit"
        after = np.minimum(before + 1, len(stamps) - 1)
        low = np.minimum(any_values[before], any_values[after])
        high = np.maximum(any_values[before], any_values[after])
        assert ((found >= low - 1e-12) & (found <= high + 1e-12)).all()
        reference = np.column_stack(
            [np.interp(times - stamps[0], stamps - stamps[0], v) for v in any_values.T]
        )
        np.testing.assert_allclose(found, reference, atol=1e-9)


def test_linear_and_slerp_bridge_no_gap_and_extrapolate_nothing() -> None:
    stamps = np.array([0, 10, 20, 100, 110]) * 1_000_000
    values, turns = np.zeros((5, 1)), np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
    for method, data in ((linear, values), (slerp, turns)):
        inside = np.array([5, 10, 20, 100, 105, 110]) * 1_000_000
        assert len(method(stamps, data, inside, "x", 10_000_000)[0]) == 6
        with pytest.raises(EpisodeError, match=r"no sample for 80.0 ms round frame 1"):
            method(stamps, data, np.array([5, 50]) * 1_000_000, "x", 50_000_000)
        with pytest.raises(EpisodeError, match=r"ends 0.0 ms before frame 0"):
            method(stamps, data, np.array([110_000_001]), "x", GAP)
        with pytest.raises(EpisodeError, match="no sample at or before frame 0"):
            method(stamps, data, np.array([-1]), "x", GAP)


def test_slerp_agrees_with_scipy_whatever_the_signs(full: bool) -> None:
    for seed in families(full):
        rng = np.random.default_rng(seed)
        stamps = stamps_of(rng, int(rng.integers(2, 30)))
        times = times_of(rng, stamps, 20)
        steps = Rotation.from_rotvec(
            rng.normal(scale=rng.choice([1e-9, 0.1, 1.0]), size=(len(stamps), 3))
        )
        turns = [Rotation.random(random_state=seed)]
        for step in steps[1:]:
            turns.append(turns[-1] * step)
        quaternions = Rotation.concatenate(turns).as_quat()
        scale = rng.choice([-1.0, 1.0], len(stamps)) * rng.uniform(0.9, 1.1, len(stamps))
        found, before = slerp(stamps, quaternions * scale[:, None], times, "x", GAP)
        expected = Slerp((stamps - stamps[0]) * 1e-9, Rotation.from_quat(quaternions))(
            (times - stamps[0]) * 1e-9
        )
        error = (Rotation.from_quat(found).inv() * expected).magnitude()
        assert error.max() < 1e-7
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
        assert (np.sum(found[1:] * found[:-1], axis=1) >= 0).all(), "no sign flips"
        assert found[0, 3] >= 0
        assert (before == previous(stamps, times, "x")).all()


def test_slerp_refuses_what_is_no_rotation() -> None:
    turns = np.array([[0, 0, 0, 1.0], [0, 0, 0, 0.0], [0, 0, np.nan, 1.0]])
    for broken in (turns[:2], turns[[0, 2]]):
        with pytest.raises(EpisodeError, match="line 3: this quaternion is none"):
            slerp(np.array([0, 10]), broken, np.array([5]), "x", GAP)
