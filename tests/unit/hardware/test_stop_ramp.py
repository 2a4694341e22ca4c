"""The link's way to rest: where it ends, how long it takes, how hard it brakes."""

from __future__ import annotations

import numpy as np
import pytest

from surg_hardware.stop_ramp import LARGEST_LAG, LEAST, StopRamp

T, STOP = 0.002, 20.0


def run(
    start: np.ndarray, ahead: np.ndarray | tuple[float, ...], cycles: tuple[int, ...] = (1,)
) -> np.ndarray:
    """Velocities and durations of the cycles until rest, (n, joints + 1); `cycles` repeat."""
    ramp, rows = StopRamp(start.tolist(), tuple(ahead), STOP), []
    for k in range(1000):
        elapsed = T * cycles[k % len(cycles)]
        rows.append([*ramp.velocity(elapsed), elapsed])
        if not any(rows[-1][:-1]):
            return np.array(rows)
    raise AssertionError("it goes on for ever")


@pytest.mark.parametrize("cycles", [(1,), (1, 2, 1, 3)], ids=["each cycle", "lost cycles"])
def test_the_targets_end_on_the_way_of_the_joints(cycles: tuple[int, ...]) -> None:
    """Joints that lag by 3 to 8.5 ms: what is beside the way is taken back."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        start = rng.uniform(-1, 1, 6) * 10 ** rng.uniform(-2, 0.4)
        ahead = start * rng.uniform(0.003, 0.0085, 6)
        rows = run(start, ahead, cycles)
        end = ahead + rows[:, -1] @ rows[:, :-1]
        u = start / np.linalg.norm(start)
        assert np.linalg.norm(end - (end @ u) * u) < 1e-9 + 1e-6 * np.linalg.norm(ahead)
        braking = np.abs(start).max() / STOP
        assert len(rows) <= max(braking, LEAST) / T + 2


def test_without_targets_the_way_is_straight_and_shorter() -> None:
    start = np.array([0.3, -0.2, 0.1, 0.0, 0.05, -0.4])
    rows = run(start, ())
    assert len(rows) == pytest.approx(0.4 / STOP / T, abs=1)
    assert np.allclose(np.cross(rows[:, :3], start[:3]), 0.0)


def test_a_wrong_target_moves_no_joint_far() -> None:
    start = np.array([0.3, -0.2, 0.1, 0.0, 0.05, -0.4])
    rows = run(start, np.array([9.0, 9.0, -9.0, 9.0, 9.0, 9.0]))
    straight = run(start, ())
    away = rows[:, -1] @ rows[:, :-1] - straight[:, -1] @ straight[:, :-1]
    assert np.abs(away).max() <= LARGEST_LAG * 0.4 + 1e-12


def test_it_brakes_little_harder_than_the_stop_deceleration() -> None:
    for leading in (0.05, 0.1, 0.4, 1.0, 3.0):
        start = leading * np.array([1.0, -0.5, 0.7, 0.2, -1.0, 0.4])
        ahead = start * np.array([0.005, 0.0062, 0.0056, 0.0074, 0.0085, 0.0068])
        speeds = np.vstack([start, run(start, ahead)[:, :-1]])
        assert np.abs(np.diff(speeds, axis=0)).max() / T <= 1.6 * STOP


def test_an_arm_at_rest_stays() -> None:
    assert not run(np.zeros(6), np.full(6, 0.01)).any(axis=0)[:-1].any()
