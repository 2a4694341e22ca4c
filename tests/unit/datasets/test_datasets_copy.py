"""Recorded videos that go into a data set without a second encoding."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import av
import pytest

from helpers.recording import dataset_readers, datasets_synthetic
from surg_recording import datasets
from surg_recording.datasets import ExportOptions
from surg_recording.datasets.formats.lerobot_part import LeRobotExporter
from surg_recording.recording_errors import EpisodeError

SECONDS = 2.4  # key frames are a second apart
COPY = ExportOptions(executor="serial", video="copy")
FORMATS = ("lerobot", "lerobot_v30")


def decoded(path: Path) -> list[str]:
    """A hash of every decoded picture: a second encoding changes each."""
    with av.open(str(path)) as container:
        return [
            hashlib.sha256(frame.to_ndarray(format="yuv420p").tobytes()).hexdigest()
            for frame in container.decode(video=0)
        ]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return datasets_synthetic.record(tmp_path_factory.mktemp("recording") / "one", 1, SECONDS)


@pytest.mark.parametrize("format_name", FORMATS)
def test_the_pictures_are_those_of_the_recording_bit_for_bit(
    format_name: str, recording: Path, tmp_path: Path
) -> None:
    report = datasets.load(format_name).write([recording], tmp_path / "out", COPY)
    assert report.ok, report.errors
    assert not any("encoded anew" in text for text in report.warnings), report.warnings
    compared = 0
    for camera in datasets_synthetic.CAMERAS:
        (video,) = (
            p for p in (tmp_path / "out").rglob("*.mp4") if camera.replace("_", ".") in str(p)
        )
        exported, recorded = decoded(video), decoded(recording / f"{camera}.mp4")
        first = recorded.index(exported[0])
        assert exported == recorded[first : first + len(exported)]
        compared += len(exported)
    wrong, total = dataset_readers.misplaced(tmp_path / "out", format_name, [1])
    assert (wrong, total) == (0, compared) and compared == 2 * report.frames
    assert datasets.check(tmp_path / "out", datasets.load(format_name)).ok


def test_other_times_than_the_cameras_are_encoded_and_said(recording: Path, tmp_path: Path) -> None:
    """Ten frames a second skip every other picture; the rest of the data set is as it was."""
    slow = ExportOptions(executor="serial", video="copy", fps=10)
    report = datasets.load("lerobot_v30").write([recording], tmp_path / "out", slow)
    assert report.ok, report.errors
    said = [text for text in report.warnings if "encoded anew" in text]
    assert len(said) == len(datasets_synthetic.CAMERAS) and "10 frames per second" in said[0]
    assert datasets.check(tmp_path / "out", datasets.load("lerobot_v30")).ok


def test_copied_and_encoded_videos_share_no_file(recording: Path, tmp_path: Path) -> None:
    """A recording that had to be encoded anew stands beside one that was copied."""
    jitter = datasets_synthetic.record(tmp_path / "jitter", 3, 1.9, jitter_ns=20_000_000)
    report = datasets.load("lerobot_v30").write([recording, jitter], tmp_path / "out", COPY)
    assert report.ok, report.errors
    assert len(list((tmp_path / "out" / "videos").rglob("*.mp4"))) == 4
    assert datasets.check(tmp_path / "out", datasets.load("lerobot_v30")).ok


def test_a_smaller_size_is_encoded(recording: Path, tmp_path: Path) -> None:
    small = ExportOptions(executor="serial", video="copy", size=(48, 32))
    report = datasets.load("lerobot_v30").write([recording], tmp_path / "out", small)
    assert report.ok and any("pixels" in text for text in report.warnings), report


def test_depth_is_left_out_by_name_and_refused_when_asked_for(
    recording: Path, tmp_path: Path
) -> None:
    depth = datasets_synthetic.copy(recording, tmp_path / "depth")
    manifest = json.loads((depth / "manifest.json").read_text())
    camera, other = datasets_synthetic.CAMERAS
    manifest["camera_streams"][camera]["encoding"] = "16UC1"
    (depth / "manifest.json").write_text(json.dumps(manifest))
    report = datasets.load("lerobot_v30").write([depth], tmp_path / "out", COPY)
    assert report.ok and any(f"left out: {camera}" in text for text in report.warnings), report
    (video,) = (tmp_path / "out").rglob("*.mp4")
    assert other.replace("_", ".") in str(video)
    asked = ExportOptions(executor="serial", cameras=(camera,))
    with pytest.raises((datasets.ExportError, EpisodeError), match=r"16UC1.*allowed"):
        datasets.load("lerobot_v30").write([depth], tmp_path / "asked", asked)


def test_an_unknown_choice_is_refused() -> None:
    with pytest.raises(ValueError, match="copy"):
        ExportOptions(video="h265")
    assert LeRobotExporter.longest_s
