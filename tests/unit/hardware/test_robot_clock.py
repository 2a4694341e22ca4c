"""The robot's time on ours: constant delay, jitter, drift, and a restart."""

import numpy as np
import pytest

from surg_hardware.robot_clock import WINDOW, RobotClock


def play(drift: float, seed: int, seconds: float = 20.0, delay: float = 0.001) -> float:
    """Worst error of the mapped time [s] after the first second."""
    rng = np.random.default_rng(seed)
    clock, worst, now = RobotClock(), 0.0, 0.0
    for k in range(int(500 * seconds)):
        robot = 100.0 + 0.002 * k
        taken = 0.002 * k * (1 + drift)  # on our clock
        now = max(now, taken + delay + rng.exponential(0.0005))
        error = clock.arrived(robot, now) - (taken + delay)
        if k > 500:
            worst = max(worst, abs(error))
    return worst


@pytest.mark.parametrize("seed", range(5))
def test_jitter_is_removed(seed: int) -> None:
    assert play(0.0, seed) < 1e-4


@pytest.mark.parametrize("drift", [-0.05, -1e-4, 1e-4, 0.05])
def test_another_clock_rate_costs_no_more_than_the_window(drift: float) -> None:
    assert play(drift, 7) < abs(drift) * WINDOW + 1e-4


def test_a_clock_that_goes_back_is_a_restart() -> None:
    clock = RobotClock()
    for k in range(2000):
        clock.arrived(50 + 0.002 * k, 0.002 * k)
    assert clock.known_for == pytest.approx(3.998)
    assert clock.restarted(0.5) and clock.restarted(float("nan"))
    assert not clock.restarted(54.0)
    assert clock.arrived(0.5, 4.0) == pytest.approx(4.0)
    assert clock.known_for == 0
