"""A device's stamps become ROS time: offset and drift from the least delays, clock steps."""

import numpy as np
import pytest

from surg_perception.capture.device_clock import DeviceClock

NS = 1_000_000_000
PERIOD = NS // 30
LEAST = 4_000_000


def run(
    clock: DeviceClock, drift: float = 0.0, seconds: float = 60.0, begin: float = 0.0, seed: int = 3
) -> np.ndarray:
    """Errors of the stamps [ns], with a least delay of 4 ms and an exponential rest of 3 ms."""
    random = np.random.default_rng(seed)
    errors = []
    for n in range(int(seconds * 30)):
        true = round(begin * NS) + n * PERIOD
        device = 5_000 * NS + round(true * (1.0 - drift))
        received = 1_700_000_000 * NS + true + LEAST + round(random.exponential(3e6))
        stamp = clock.ros_time(device, received)
        assert stamp <= received
        errors.append(stamp - (1_700_000_000 * NS + true))
    return np.asarray(errors)


@pytest.mark.parametrize("drift", [0.0, 20e-6, -80e-6])
def test_stamps_are_the_exposures_plus_the_least_delay(drift: float) -> None:
    clock = DeviceClock()
    errors = run(clock, drift)[600:] - LEAST
    assert np.abs(errors).max() < 500_000
    assert clock.drift == pytest.approx(drift, abs=10e-6)
    assert clock.steps == 0


@pytest.mark.parametrize("step", [3600.0, -7.0, 0.5])
def test_a_step_of_ros_time_is_followed_at_once_or_within_half_a_second(step: float) -> None:
    clock = DeviceClock()
    run(clock)
    late = []
    for n in range(60):
        device = 5_000 * NS + 60 * NS + n * PERIOD
        true = 1_700_000_060 * NS + round(step * NS) + n * PERIOD
        late.append(clock.ros_time(device, true + LEAST) - true)
    assert clock.steps == 1
    settled = late[0 if step < 0 else 15 :]
    assert np.abs(np.asarray(settled) - LEAST).max() < 1_000_000


def test_a_reset_of_the_device_is_followed_at_once() -> None:
    clock = DeviceClock()
    run(clock)
    received = 1_700_000_061 * NS
    assert clock.ros_time(12_345, received) == received
    assert clock.steps == 1


def test_one_late_picture_moves_nothing() -> None:
    clock = DeviceClock()
    run(clock)
    device = 5_000 * NS + 60 * NS
    true = 1_700_000_060 * NS
    stamp = clock.ros_time(device, true + 2 * NS)  # held up for two seconds
    assert abs(stamp - true - LEAST) < 1_000_000
    assert clock.steps == 0
