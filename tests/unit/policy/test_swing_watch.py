"""Commands that swing are named; motions on purpose are not."""

from __future__ import annotations

import numpy as np
import pytest

from surg_core.contract import SECOND_NS, STEP_NS
from surg_policy_bridge.server.swing_watch import SwingWatch


def rows_until_named(x: np.ndarray) -> int | None:
    """After how many rows of these x [mm] a swing is named; None: never."""
    watch = SwingWatch(["PSM1"])
    for k, value in enumerate(x):
        watch.take(np.array([1e-3 * value, 0.0, 0.12, 0.0, 0.5]), k * STEP_NS)
        if watch.warning:
            assert "PSM1" in watch.warning and "along x" in watch.warning
            return k + 1
    return None


def triangle(amplitude: float, rows: int, count: int = 80) -> np.ndarray:
    """To and fro [mm], so many rows each way."""
    phase = np.arange(count) % (2 * rows)
    return amplitude * np.minimum(phase, 2 * rows - phase) / rows


@pytest.mark.parametrize("x", [triangle(4, 1), triangle(10, 4), triangle(70, 12)])
def test_a_swing_is_named_within_two_seconds(x: np.ndarray) -> None:
    """Three turns of at least 2 mm: at the latest after 4 × 12 rows of 50 ms."""
    found = rows_until_named(x)
    assert found is not None and found * STEP_NS <= 2.5 * SECOND_NS


def test_an_overshooting_stream_is_named() -> None:
    """As measured where steps of 2 mm were counted from a set-point that runs ahead."""
    t = np.arange(80) * STEP_NS / SECOND_NS
    assert rows_until_named(35 * np.sin(2 * np.pi * t / 1.2)) is not None


@pytest.mark.parametrize(
    "x",
    [
        np.linspace(0, 100, 80),
        triangle(1.5, 1),  # below the size of a turn
        np.repeat(triangle(20, 1, 16), 6),  # it rests for 0.3 s at each turn
        5 * np.cos(2 * np.pi * np.arange(200) / 100),  # the circle of `scripted`, 5 s a turn
        np.concatenate([triangle(30, 10, 21), np.zeros(50)]),  # there and back
    ],
)
def test_a_motion_on_purpose_is_not(x: np.ndarray) -> None:
    assert rows_until_named(x) is None


def test_each_episode_begins_anew() -> None:
    watch = SwingWatch(["PSM1", "PSM2"])
    for k, value in enumerate(triangle(10, 2)):
        watch.take(np.array([0, 0, 0.1, 0, 0, 0, 1e-3 * value, 0.1, 0, 0]), k * STEP_NS)
    assert "PSM2" in watch.warning and "along y" in watch.warning
    watch.start()
    assert watch.warning == ""
