"""Only a live picture passes: black, blue, bars, frozen, half, interlaced, other sizes do not."""

import numpy as np
import pytest

from surg_perception.capture.signal_watch import CURES, Signal, SignalWatch

MS = 1_000_000
SHAPE = (240, 320, 3)


def scene(seed: int = 0, noise: float = 2.0, at: float = 0.0) -> np.ndarray:
    """Smooth shapes, an edge that stands ``at`` [px], noise and the round edge of an endoscope."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    value = 130 + 60 * np.sin(x / 37) * np.cos(y / 23)
    value[:, :] += np.where(x > 150 + at, 45, -45)
    picture = np.stack([value, value * 0.7, value * 0.6], -1)
    picture += random.normal(0, noise, SHAPE)
    outside = np.hypot(x - 159.5, y - 119.5) > 150
    picture[outside] = random.normal(4, 1, SHAPE)[outside]
    return picture.clip(0, 255).astype(np.uint8)


def bars() -> np.ndarray:
    colours = [(235, 235, 235), (235, 235, 16), (16, 235, 235), (16, 235, 16), (235, 16, 235),
               (235, 16, 16), (16, 16, 235)]  # fmt: skip
    row = np.repeat(np.array(colours, np.uint8), 46, axis=0)[:320]
    return np.broadcast_to(row, SHAPE).copy()


def labelled_bars() -> np.ndarray:
    """With a text at the upper left and a grey scale below."""
    picture = bars()
    picture[8:40, 8:200][::3] = 255
    picture[180:] = np.linspace(0, 255, 320)[:, None]
    return picture


def half() -> np.ndarray:
    picture = scene()
    picture[125:] = (0, 135, 0)  # what a decoder makes of rows that never came
    return picture


def interlaced(seed: int) -> np.ndarray:
    """Two fields, the second one with the edge 14 px farther."""
    picture = scene(seed, at=14.0 * seed)
    picture[1::2] = scene(seed + 100, at=14.0 * seed + 14.0)[1::2]
    return picture


@pytest.mark.parametrize("noise", [0.5, 2.0, 5.0])
def test_a_live_scene_passes(noise: float) -> None:
    watch = SignalWatch((320, 240))
    pictures = [scene(n, noise, at=14.0 * n) for n in range(7)]
    for n in range(60):
        assert watch.judge(pictures[n % 7], n * 33 * MS) is Signal.LIVE


@pytest.mark.parametrize(
    ("picture", "expected"),
    [
        (np.full(SHAPE, 16, np.uint8), Signal.BLACK),
        (np.full(SHAPE, (0, 0, 255), np.uint8), Signal.BLUE),
        (np.full(SHAPE, (20, 30, 190), np.uint8), Signal.BLUE),
        (bars(), Signal.BARS),
        (labelled_bars(), Signal.BARS),
        (half(), Signal.HALF),
        (scene()[:120], Signal.WRONG_SIZE),
    ],
    ids=["black", "blue", "dark_blue", "bars", "labelled_bars", "half", "size"],
)
def test_what_is_no_live_picture_is_named_at_once(picture: np.ndarray, expected: Signal) -> None:
    assert SignalWatch((320, 240)).judge(picture, 0) is expected
    assert expected in CURES


def test_a_picture_that_stays_the_same_for_a_second_is_frozen() -> None:
    watch, picture = SignalWatch(), scene()
    found = [watch.judge(picture, n * 100 * MS) for n in range(12)]
    assert found == [Signal.LIVE] * 10 + [Signal.FROZEN] * 2
    assert watch.judge(scene(1), 1_200 * MS) is Signal.LIVE


def test_a_recording_may_stand_still() -> None:
    watch, picture = SignalWatch(still=True), scene()
    assert {watch.judge(picture, n * 100 * MS) for n in range(30)} == {Signal.LIVE}


def test_fields_that_move_apart_are_interlaced_but_rows_of_two_eyes_are_not() -> None:
    watch, rows = SignalWatch(), SignalWatch(rows=True)
    pictures = [interlaced(n) for n in range(6)]
    found = [watch.judge(pictures[n % 6], n * 33 * MS) for n in range(30)]
    assert found[0] is Signal.LIVE  # one picture proves nothing
    assert found[-1] is Signal.INTERLACED
    passed = [rows.judge(pictures[n % 6], n * 33 * MS) for n in range(30)]
    assert set(passed) == {Signal.LIVE}


def test_a_dark_lower_edge_of_the_endoscopes_circle_is_no_missing_half() -> None:
    picture = scene()
    picture[235:] = 4
    assert SignalWatch().judge(picture, 0) is Signal.LIVE


@pytest.mark.parametrize("radius", [60, 85, 110])
def test_a_small_circle_in_a_dark_picture_is_whole(radius: float) -> None:
    picture = scene()
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    picture[np.hypot(x - 159.5, y - 70) > radius] = 4
    assert SignalWatch().judge(picture, 0) is Signal.LIVE
