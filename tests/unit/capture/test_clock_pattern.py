"""The time in a clock pattern is read back exactly from a picture of it, or not at all."""

import binascii
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.teleop import chromium
from surg_perception.capture import clock_pattern, latency
from surg_perception.capture.latency import LatencyError


def seen(time_ms: int, seed: int, blur: float = 1.2, noise: float = 6.0) -> np.ndarray:
    """The pattern from aside, turned, out of focus, dim and noisy, in a picture of 640 x 480."""
    random = np.random.default_rng(seed)
    pattern = clock_pattern.drawn(time_ms)
    height, width = pattern.shape
    size, angle = random.uniform(0.55, 0.95), random.uniform(0, 2 * np.pi)
    corners = np.array([(-1, -0.8), (1, -0.8), (1, 0.8), (-1, 0.8)]) * 190 * size
    corners += random.uniform(-22, 22, (4, 2)) * size
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corners = corners @ turn.T + (320, 240) + random.uniform(-20, 20, 2)
    edge = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float32)
    warp = cv2.getPerspectiveTransform(edge, corners.astype(np.float32))
    grey = cv2.warpPerspective(pattern, warp, (640, 480), borderValue=120).astype(float)
    grey = cv2.GaussianBlur(30 + 0.6 * grey, (0, 0), blur) + random.normal(0, noise, grey.shape)
    picture = np.stack([grey, 0.9 * grey, 0.8 * grey], -1)
    return picture.clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("time_ms", [0, 1, 2**24 - 1, 0x123456, 1_700_000_000_123])
def test_a_drawn_pattern_is_read_back(time_ms: int) -> None:
    assert clock_pattern.read(clock_pattern.drawn(time_ms)) == time_ms % 2**24


def test_a_pattern_is_read_at_any_turn_and_slant_and_never_wrong() -> None:
    random = np.random.default_rng(7)
    times = random.integers(0, 2**24, 24)
    found = [clock_pattern.read(seen(int(t), seed)) for seed, t in enumerate(times)]
    print(f"{sum(f is not None for f in found)} of {len(times)} read")
    assert all(f in (None, t) for f, t in zip(found, times, strict=True))
    assert sum(f is not None for f in found) >= 23


def test_two_times_in_one_exposure_are_no_time() -> None:
    for first in range(1000, 1400, 16):
        both = clock_pattern.drawn(first).astype(int) + clock_pattern.drawn(first + 17)
        time_ms = clock_pattern.read((both // 2).astype(np.uint8))
        assert time_ms in (None, first, first + 17)
    torn = clock_pattern.drawn(1000)
    torn[len(torn) // 2 :] = clock_pattern.drawn(900_000)[len(torn) // 2 :]
    assert clock_pattern.read(torn) is None


def test_a_picture_without_a_pattern_has_no_time() -> None:
    random = np.random.default_rng(2)
    assert clock_pattern.read(random.integers(0, 256, (240, 320, 3), np.uint8)) is None
    assert clock_pattern.read(np.zeros((240, 320, 3), np.uint8)) is None


def test_the_check_sum_is_crc_ccitt() -> None:
    for value in (0, 0x313233, 0xFFFFFF):
        assert clock_pattern.crc16(value) == binascii.crc_hqx(value.to_bytes(3, "big"), 0xFFFF)


def test_the_age_goes_over_the_end_of_the_period() -> None:
    assert clock_pattern.age_ms(1_700_000_000_100_000_000, 1_700_000_000_020 % 2**24) == 80
    assert clock_pattern.age_ms(2**24 * 1_000_000 + 30_000_000, 2**24 - 50) == 80
    assert clock_pattern.age_ms(0, 5) == -5


def test_the_latency_is_the_median_plus_what_is_subtracted_already() -> None:
    random = np.random.default_rng(3)
    ages: list[float | None] = [*(72.0 + random.uniform(-8, 8, 200)), *[None] * 100]
    found = latency.of_ages(ages)
    assert found.seconds == pytest.approx(0.072, abs=0.001)
    assert found.spread == pytest.approx(0.0144, abs=0.001)
    assert (found.read, found.seen) == (200, 300)
    assert latency.of_ages(ages, 0.05).seconds == pytest.approx(found.seconds + 0.05)


@pytest.mark.parametrize(
    ("ages", "words"),
    [
        ([], "0 of 0"),
        ([70.0] * 59, "59 of 59"),
        ([70.0] * 60 + [None] * 300, "60 of 360"),
        ([-40.0] * 100, "synchronise the clocks"),
        ([1500.0] * 100, "synchronise the clocks"),
        (list(np.linspace(20.0, 120.0, 100)), "spreads over"),
    ],
)
def test_pictures_that_do_not_tell_are_refused(ages: list[float | None], words: str) -> None:
    with pytest.raises(LatencyError, match=words):
        latency.of_ages(ages)


def test_the_page_draws_the_pattern(full: bool, tmp_path: Path) -> None:
    if not full or chromium.missing():
        pytest.skip(chromium.missing() or "starts a browser; SURG_TEST_FULL=1")
    page = Path(clock_pattern.__file__).with_name("clock_pattern.html")
    for time_ms in (0, 7_654_321, 2**24 + 77):
        picture = tmp_path / f"{time_ms}.png"
        argv = [chromium.PROGRAM, "--headless=new", "--no-sandbox", "--disable-gpu"]
        argv += [f"--user-data-dir={tmp_path}", f"--screenshot={picture}", "--window-size=800,600"]
        subprocess.run([*argv, f"file://{page}?ms={time_ms}"], check=True, capture_output=True)
        seen = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)
        assert clock_pattern.read(np.asarray(seen, np.uint8)) == time_ms % 2**24
