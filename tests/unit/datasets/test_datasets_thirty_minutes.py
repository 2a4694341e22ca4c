"""A 30-minute stereo episode in simulated time: recorded, exported, read by lerobot 0.4.4.

Opt-in (`./surg test --full --tier oracle`). `-- -k copy` takes the recorded video as it is, `-- -k
encode` encodes it once more, which takes longest. SURG_TEST_MINUTES shortens the episode. A made-up
arm moves in simulated time; recorder, encoders, export and reader are the real ones.
"""

from __future__ import annotations

import functools
import os
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from helpers.machines.peak_memory import watched
from helpers.policy import lerobot_venv
from helpers.recording import datasets_synthetic, felt_forces, picture_identity
from helpers.recording.datasets_synthetic import FRAME_NS
from helpers.recording.oracle_reading import run
from helpers.recording.picture_identity import COLUMNS, ROWS, Identity
from helpers.recording.recording_synthetic import Synthetic
from helpers.results import dataset_results
from surg_recording import datasets
from surg_recording.datasets import ExportOptions

pytestmark = [pytest.mark.oracle, pytest.mark.full]

MINUTES = float(os.environ.get("SURG_TEST_MINUTES", "30"))
SIZE = 640, 480
SECONDS = 60 * MINUTES
NUMBERS = 1 << 15
"""Frames that a picture can tell apart; later ones count from 0 again."""
MOST_MIB = 300
"""Of each process of an export."""


def note(row: str, cases: int, told: str) -> None:
    """Print a figure; one of a whole episode is for the page."""
    print(f"{row}: {cases}: {told}")
    if MINUTES >= 30:
        dataset_results.note(f"30 minutes: {row}", cases, told)


@functools.cache
def _textures() -> npt.NDArray[np.uint8]:
    """Grain that no encoder gets for nothing, by frame number modulo its length."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 30, (70, 90, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    views = [coarse[2 * n : 2 * n + SIZE[1], 2 * n : 2 * n + SIZE[0]] for n in range(32)]
    return np.stack(views) + rng.integers(0, 10, (32, SIZE[1], SIZE[0], 3), np.uint8)


def picture(identity: Identity, width: int, height: int) -> npt.NDArray[np.uint8]:
    """A textured picture that says which it is (modulo ``NUMBERS``)."""
    shown = Identity(identity.recording, identity.camera, identity.frame % NUMBERS)
    small = picture_identity.draw(shown, COLUMNS, 2 * ROWS)[..., 0]
    squares = np.repeat(np.repeat(small, height // (2 * ROWS), 0), width // COLUMNS, 1)
    image = _textures()[identity.frame % 32].copy()
    image[:, : squares.shape[1]] += (squares // 2 + 40)[..., None]
    return image


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The episode, for both ways of its video."""
    lerobot_venv.python("0.4.4")  # before the long part: skips where it cannot be made
    folder = tmp_path_factory.mktemp("long") / "episode"
    started = time.monotonic()
    with watched(os.getpid()) as used:
        made = datasets_synthetic.record(
            folder, 1, SECONDS, size=SIZE, picture=picture, paced=True, felt=True
        )
    size = sum(path.stat().st_size for path in made.iterdir()) / 2**20
    told = f"{time.monotonic() - started:.0f} s, {size:.0f} MiB; recorder {used.own:.0f} MiB,"
    note("recorded", round(MINUTES), f"{told} each encoder at most {used.child:.0f} MiB")
    return made


@pytest.mark.parametrize("video", ["copy", "encode"])
def test_a_long_stereo_episode_goes_all_the_way(
    video: str, recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "set"
    options = ExportOptions(executor="process", workers=1, splits={"train": 1.0}, video=video)
    exporter = datasets.load("lerobot_v30")
    foreseen = datasets.dry_run(exporter, [recording], options, lambda part, text: None)
    started = time.monotonic()
    with watched(os.getpid()) as used:
        report = exporter.write([recording], out, options)
    assert report.ok, report
    took = time.monotonic() - started
    assert not any("encoded anew" in text for text in report.warnings), report.warnings
    told = f"{took:.0f} s, {report.frames / took:.0f} frames/s; worker"
    told = f"{told} {used.child:.0f} MiB, export {used.own:.0f} MiB"
    note(f"exported as LeRobot 3.0, `--video {video}`", report.frames, told)
    assert used.child <= MOST_MIB

    words = (out, 10, 1)
    versions, facts, *frames = run("0.4.4", "lerobot_reader.py", *words, home=tmp_path)
    assert versions["lerobot"] == "0.4.4"
    assert facts["frames"] == report.frames >= 20 * (SECONDS - 1)
    pieces = int(np.ceil(report.frames / 20_000))
    assert facts["episodes"] == report.recordings == foreseen.recordings == pieces
    assert len(frames) == 10
    what = Synthetic(seconds=SECONDS)
    for frame in frames:
        assert frame["index"] == frame["asked"]
        shown = list(frame["pictures"].values())
        number = frame["grid_ns"] // FRAME_NS % NUMBERS
        assert shown == [[1, camera, number] for camera in (0, 1)]
        expected = what.executed(frame["grid_ns"] * 1e-9)
        assert frame["state"][:3] == pytest.approx(list(expected), abs=1e-7)
        forces = felt_forces.expected(frame["grid_ns"])
        assert frame["force"] == pytest.approx(forces, rel=1e-6, abs=1e-6)
    told = "20 pictures, states, forces right"
    note(f"opened by lerobot 0.4.4, `--video {video}`", 10, told)
