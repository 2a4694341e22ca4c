"""Cameras that misbehave and encoders that die: counted, said, and the rest goes on."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from helpers.recording import camera_recording
from helpers.recording import recording_synthetic as synthetic
from helpers.recording.camera_recording import start, until
from helpers.results.recording_results import note
from surg_recording.episode import episode_reader
from surg_recording.video import camera_sink, video_file

PERIOD_NS = 50_000_000


def numbers(recorded: episode_reader.Episode) -> list[int]:
    """Numbers of all frames of all parts, as the sidecars and the pictures say."""
    found: list[int] = []
    for video in recorded.parts("cam"):
        stamps = video.frames["stamp_ns"] // PERIOD_NS
        images = video_file.grab(video.path, list(range(len(stamps))))
        assert len(images) == len(stamps)
        for number, image in zip(stamps, images, strict=True):
            assert abs(float(image.mean()) - number * 7 % 256) < 4
        found += stamps.tolist()
    return found


def test_a_camera_that_changes_its_size_goes_on_in_a_further_part(tmp_path: Path) -> None:
    recording = start(tmp_path / "e")
    for k in range(1, 31):
        width, height = (96, 64) if not 11 <= k <= 20 else (64, 48)
        recording.image("cam", synthetic.image(k * PERIOD_NS, k, width, height), k)
    recorded = episode_reader.read(recording.close({}))
    assert numbers(recorded) == list(range(1, 31)), "no frame is lost"
    assert recorded.cameras == ["cam"]
    assert [video.name for video in recorded.parts("cam")] == ["cam", "cam.2", "cam.3"]
    assert not recorded.complete
    assert "its size changed from 96x64 to 64x48: goes on in cam.2" in recorded.manifest["reason"]
    stream = recorded.manifest["camera_streams"]["cam"]
    assert (stream["parts"], stream["size"]) == (3, "96x64")


def test_a_camera_that_never_settles_is_given_up_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_sink, "MAX_PARTS", 3)
    recording = start(tmp_path / "e")
    for k in range(1, 41):
        recording.image("cam", synthetic.image(k * PERIOD_NS, k, 96 - 32 * (k % 2), 64), k)
    recorded = episode_reader.read(recording.close({}))
    assert len(recorded.parts("cam")) == 3
    kept = numbers(recorded)
    assert kept[:3] == [1, 2, 3]
    assert len(kept) + recorded.manifest["videos"]["cam"]["dropped"] == 40
    assert "3 parts are enough" in recorded.manifest["reason"]


@pytest.mark.parametrize("mode", ["freerun", "lockstep"])
def test_f13_a_killed_encoder_costs_half_a_second_and_the_camera_goes_on(
    tmp_path: Path, mode: str, full: bool
) -> None:
    rng = np.random.default_rng(5)
    recording = start(tmp_path / "e", mode)
    kills = 7 if full else 2  # more parts than eight are not made
    k = 0
    for _ in range(kills):
        for _ in range(int(rng.integers(25, 45))):
            k += 1
            recording.image("cam", synthetic.image(k * PERIOD_NS, k), k)
            time.sleep(0.004)
        os.kill(recording.cameras.sinks["cam"].part.pid, signal.SIGKILL)
        until(lambda: recording.cameras.sinks["cam"].part.error is not None)
        k += 1
        recording.image("cam", synthetic.image(k * PERIOD_NS, k), k)  # starts the next encoder
        until(lambda: recording.status()["backlog"]["frames"] == 0)
    for _ in range(25):
        k += 1
        recording.image("cam", synthetic.image(k * PERIOD_NS, k), k)
        time.sleep(0.004)
    recorded = episode_reader.read(recording.close({}))
    found = numbers(recorded)
    lost = sorted(set(range(1, k + 1)) - set(found))
    assert found == sorted(set(found)) and found[0] == 1 and found[-1] == k
    assert len(recorded.parts("cam")) == kills + 1
    gaps = np.diff(found)
    worst = float((gaps.max() - 1) * PERIOD_NS * 1e-9)
    result = f"{len(lost)} of {k} frames lost, at most {worst:.2f} s in a row (≤ 0.5), all counted"
    note(f"kill -9 of the encoder, recorder lives, {mode}", kills, result)
    assert worst <= 0.5
    assert "the encoder failed" in recorded.manifest["reason"]
    said = sum(int(video.frames["dropped"].sum()) for video in recorded.parts("cam"))
    assert said == len(lost), "each lost frame is counted where it is missing"
    assert recorded.manifest["videos"]["cam"]["dropped"] == len(lost)


def test_f08_a_camera_that_stalls_is_said_and_may_come_back(tmp_path: Path) -> None:
    recording = start(tmp_path / "e")
    for k in range(1, 11):
        recording.image("cam", synthetic.image(k * PERIOD_NS, k), k * PERIOD_NS)
    heard = time.monotonic()
    recording.watch_cameras(heard + 0.10, 1)
    assert recording.cameras.silent == []
    recording.watch_cameras(heard + 0.2, 2)  # more than 3 periods of 50 ms
    assert recording.cameras.silent == ["cam"]
    recording.watch_cameras(heard + 0.3, 3)
    recording.image("cam", synthetic.image(11 * PERIOD_NS, 11), 11 * PERIOD_NS)
    recording.watch_cameras(time.monotonic(), 4)
    assert recording.cameras.silent == []
    recorded = episode_reader.read(recording.close({}))
    events = recorded.table("events")
    assert list(events["topic"]) == ["camera_stall", "camera_back"]
    assert recorded.warnings == ["cam: fell silent for more than 0.15 s"]
    assert recorded.complete, "what was sent is there"


PIXELS = {
    "rgba8": (90, 90, 90, 255),
    "bgra8": (90, 90, 90, 7),
    "8UC3": (90, 90, 90),
    "8UC1": (90,),
    "yuv422_yuy2": (93, 128),
}
"""A grey of 90 in each encoding."""


def test_more_encodings_of_ros_images_and_frozen_pictures_are_counted(tmp_path: Path) -> None:
    recording = camera_recording.start(tmp_path / "e", cameras=PIXELS)
    for encoding, pixel in PIXELS.items():
        for k in range(1, 4):
            image = synthetic.image(k * PERIOD_NS, k)
            image.encoding, image.step = encoding, 96 * len(pixel)
            image.data = bytes(pixel) * (96 * 64)
            recording.image(encoding, image, k * PERIOD_NS)
    recorded = episode_reader.read(recording.close({}))
    assert recorded.complete, recorded.manifest["reason"]
    for encoding in PIXELS:
        (picture,) = video_file.grab(recorded.video(encoding).path, [2])
        assert abs(float(picture.mean()) - 90) < 4, encoding
        assert recorded.manifest["camera_streams"][encoding]["repeated"] == 2
