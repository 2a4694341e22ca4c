"""The lag of a video against the kinematics: found where it can be, denied where it cannot."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest

from helpers.recording.moving_pictures import Scene, tremor, wander
from helpers.results import sync_results
from surg_recording.clock.verdict import CANNOT_TELL, FAIL, PASS
from surg_recording.video import image_motion, video_lag
from surg_recording.video.image_motion import HEIGHT, WIDTH, ImageMotion
from surg_recording.video.video_lag import LagEstimate, TipPath

FRAME = 0.05
Array = npt.NDArray[np.float64]


@dataclasses.dataclass
class Case:
    """A video of an arm at work, made up."""

    seed: int
    lag: float = 0.0
    seconds: float = 20.0
    still: bool = False
    period: float | None = None
    """The tip goes to and fro with this period [s]."""
    scene: Scene = dataclasses.field(default_factory=Scene)

    def path(self) -> TipPath:
        rng = np.random.default_rng(self.seed)
        t = np.arange(-1.0, self.seconds + 1.0, 0.002)
        p = np.zeros((len(t), 3)) if self.still else wander(rng, t + 1.0)
        if self.period:
            p = np.outer(0.02 * np.sin(2 * np.pi * t / self.period), [1.0, 0.0, 0.0])
        return TipPath(t, p + tremor(rng, t))

    def film(self) -> tuple[Array, ImageMotion, TipPath]:
        path = self.path()
        stamps = np.arange(0.0, self.seconds, FRAME) + 0.01 * (self.seed % 5)
        taken = stamps - self.lag
        p = np.stack([np.interp(taken, path.t, path.p[:, i]) for i in range(3)], axis=1)
        scene = dataclasses.replace(self.scene, seed=self.seed)
        pictures = scene.pictures(taken, p)
        return stamps, image_motion.of_frames((picture, False) for picture in pictures), path

    def estimate(self) -> LagEstimate:
        stamps, motion, path = self.film()
        return video_lag.estimate(stamps, motion, {"PSM1": path})


def seeds(full: bool, few: int, many: int) -> range:
    return range(many if full else few)


def test_a_lag_of_200_ms_is_found_within_one_frame(full: bool) -> None:
    """Injected into videos with breathing tissue, light that varies, and noise."""
    found = [Case(seed, lag=0.2).estimate() for seed in seeds(full, 4, 100)]
    verdicts = [estimate.verdict for estimate in found]
    errors = [abs(estimate.lag - 0.2) for estimate in found if estimate.lag is not None]
    told = f"{verdicts.count(FAIL)} found, none passed; largest error {max(errors) * 1e3:.1f} ms"
    sync_results.note("a lag of 200 ms", len(found), f"{told}, a frame is {FRAME * 1e3:.0f} ms")
    assert PASS not in verdicts
    assert verdicts.count(FAIL) >= 0.9 * len(found)
    assert max(errors) < FRAME


@pytest.mark.parametrize("lag", [-0.7, 0.0, 0.013, 1.5])
def test_any_lag_is_found(lag: float, full: bool) -> None:
    for seed in seeds(full, 1, 25):
        found = Case(seed + 500, lag=lag).estimate()
        if found.verdict != CANNOT_TELL:
            assert found.lag == pytest.approx(lag, abs=FRAME)
            assert found.verdict == (PASS if abs(lag) < FRAME else FAIL)


def test_nothing_moves(full: bool) -> None:
    tried = seeds(full, 1, 50)
    for seed in tried:
        found = Case(seed, still=True).estimate()
        assert found.verdict == CANNOT_TELL
        assert found.reason.startswith("nothing moves")
        assert found.lag is None
    sync_results.note("nothing moves", len(tried), "cannot tell, each time")


def test_breathing_is_not_taken_for_the_instrument(full: bool) -> None:
    """The arm works, the picture shows breathing tissue only: there is nothing to compare."""
    scene = Scene(visible=False, breathing=4.0)
    found = [Case(seed, lag=0.2, scene=scene).estimate().verdict for seed in seeds(full, 4, 300)]
    known = len(found) - found.count(CANNOT_TELL)
    told = f"cannot tell {found.count(CANNOT_TELL)} times, a lag {known} times"
    sync_results.note("breathing tissue, the instrument out of view", len(found), told)
    assert set(found) == {CANNOT_TELL}


@pytest.mark.parametrize("period", [4.0, 2.0])
def test_a_motion_that_repeats_itself_does_not_tell(period: float) -> None:
    """With the period of the breaths, and with half of it."""
    found = Case(3, lag=0.2, period=period).estimate()
    assert found.verdict == CANNOT_TELL


def test_light_alone_is_no_motion() -> None:
    """A brighter light, also uneven, leaves nothing in the difference of two pictures."""
    rng = np.random.default_rng(1)
    picture = rng.uniform(60, 120, (HEIGHT, WIDTH))
    glow = 1.0 + 0.4 * np.outer(np.linspace(0, 1, HEIGHT), np.linspace(0, 1, WIDTH))

    def energy(after: Array) -> float:
        frames = [picture, after] * 2 + [after] * 3
        return float(
            image_motion.of_frames((f.astype(np.uint8), False) for f in frames).energy.max()
        )

    moved = np.roll(picture, 2, axis=1)
    assert energy(picture * glow) < 0.1 * energy(moved)


def test_what_the_codec_changes_does_not_count() -> None:
    rng = np.random.default_rng(2)
    frames = [rng.integers(0, 255, (HEIGHT, WIDTH)).astype(np.uint8) for _ in range(6)]
    coded = [True, False, False, True, False, False]
    motion = image_motion.of_frames(zip(frames, coded, strict=True))
    assert motion.usable.tolist() == [True, True, False, True, True]


def test_of_two_arms_the_one_in_view_is_believed() -> None:
    stamps, motion, seen = Case(7, lag=0.2).film()
    other = Case(8).path()
    found = video_lag.estimate(stamps, motion, {"PSM2": other, "PSM1": seen})
    assert found.seen == "PSM1"
    assert found.lag == pytest.approx(0.2, abs=FRAME)


def test_frames_that_were_dropped_do_no_harm() -> None:
    case = Case(9, lag=0.2)
    path = case.path()
    rng = np.random.default_rng(9)
    stamps = np.arange(0.0, 20.0, FRAME)
    stamps = stamps[rng.random(len(stamps)) > 0.2]
    p = np.stack([np.interp(stamps - 0.2, path.t, path.p[:, i]) for i in range(3)], axis=1)
    pictures = Scene(seed=9).pictures(stamps - 0.2, p)
    motion = image_motion.of_frames((picture, False) for picture in pictures)
    found = video_lag.estimate(stamps, motion, {"PSM1": path})
    assert found.lag == pytest.approx(0.2, abs=FRAME)


@pytest.mark.parametrize("frames", [0, 1, 2, 30])
def test_a_short_video_does_not_tell(frames: int) -> None:
    motion = ImageMotion(np.ones(max(frames - 1, 0)), np.ones(max(frames - 1, 0), dtype=bool))
    stamps = np.arange(frames) * FRAME
    found = video_lag.estimate(stamps, motion, {"PSM1": Case(1).path()})
    assert found.verdict == CANNOT_TELL
    assert "frames" in found.reason


def test_without_an_arm_there_is_nothing_to_compare() -> None:
    motion = ImageMotion(np.ones(200), np.ones(200, dtype=bool))
    found = video_lag.estimate(np.arange(201) * FRAME, motion, {})
    assert found.verdict == CANNOT_TELL
