"""F09: of a recording whose clock was set, the longest segment is exported, and it is right."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.recording import dataset_readers, datasets_synthetic, picture_identity
from helpers.recording.datasets_synthetic import FRAME_NS
from helpers.recording.recording_synthetic import Synthetic
from helpers.recording.stepped_recording import CAMERA, START_NS, Stepped
from surg_recording import datasets
from surg_recording.clock import clock_segments, sync_report
from surg_recording.datasets import ExportError, ExportOptions, Report
from surg_recording.episode import episode_reader
from surg_recording.recording_errors import EpisodeError

HOUR = 3600 * 10**9
SERIAL = ExportOptions(executor="serial", splits={"train": 1.0})


def export(folder: Path, out: Path, options: ExportOptions = SERIAL) -> Report:
    return datasets.load("act").write([folder], out, options)


@pytest.fixture(autouse=True)
def one_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dataset_readers, "CAMERAS", (CAMERA,))


def wrong_frames(out: Path, made: Stepped, segment: int) -> tuple[int, int]:
    """Frames whose picture or motion is not the one of their time, and all frames.

    A picture says when it was taken, and the tip when it was there: by the clock that nobody sets.
    """
    wrong = total = 0
    what = Synthetic(seconds=made.seconds)
    for frame in dataset_readers.frames(out, "act"):
        total += 1
        now = made.true_s(frame.grid_ns, segment)
        taken = picture_identity.read(frame.pictures[0]).frame * FRAME_NS * 1e-9
        age = now - taken
        there = np.allclose(frame.state[:3], what.executed(now), atol=1e-6)
        wrong += not (-1e-4 < age < 0.0501 and there)
    return wrong, total


SECONDS = 6.0
STEPS: dict[str, tuple[tuple[tuple[int, int], ...], int]] = {
    "back, the end is longer": (((900, -HOUR),), 1),
    "forward by little": (((901, 20_000_000),), 1),
    "twice, the middle is longest": (((480, 30_000_000), (2461, -2 * 10**9)), 1),
    "forward, the end is longer": (((901, HOUR),), 1),
    "back by little": (((901, -700_000_000),), 1),
    "back, the beginning is longer": (((2101, -HOUR),), 0),
}
"""(tick, step) and the longest segment."""
MANY = [
    pytest.param(name, marks=[] if name.startswith("twice") else pytest.mark.full) for name in STEPS
]


@pytest.mark.parametrize("name", MANY)
def test_the_longest_segment_is_exported_and_every_frame_is_right(
    tmp_path: Path, name: str
) -> None:
    steps, longest = STEPS[name]
    made = Stepped(SECONDS, steps)
    folder = made.record(tmp_path / "e")
    recorded = episode_reader.read(folder)
    assert recorded.complete, recorded.manifest["reason"]
    report = export(folder, tmp_path / "set")
    assert report.ok, (report.errors, report.refused)
    wrong, total = wrong_frames(tmp_path / "set", made, longest)
    ends = [0.0, *(at * 0.002 for at, _ in steps), SECONDS]
    length = ends[longest + 1] - ends[longest]
    sides = (longest > 0) + (longest < len(steps))
    print(f"{name}: {total} frames of {length:.1f} s, {wrong} wrong")
    assert wrong == 0
    other, _ = wrong_frames(tmp_path / "set", made, longest - 1 if longest else 1)
    assert other == total, "by the clock of another segment nothing is right"
    assert length - sides - 0.4 < total / 20 <= length - sides + 0.05
    said = f"of its {len(steps) + 1} segments number {longest + 1}, the longest"
    (warning,) = [text for text in report.warnings if "clock was set" in text]
    assert said in warning and str(folder) in warning
    stated = json.loads((tmp_path / "set" / "surg_export.json").read_text())
    assert said in stated["recordings"][0]["notes"]["segment"]


def test_without_the_guard_it_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was stamped before the step and came after it never gets into a dataset."""
    folder = Stepped(4.0, ((501, -700_000_000),)).record(tmp_path / "e")
    monkeypatch.setattr(clock_segments, "GUARD_NS", 0)
    monkeypatch.setattr(clock_segments, "EDGE", 0)
    assert refused(folder, tmp_path / "set")
    monkeypatch.undo()
    monkeypatch.setattr(dataset_readers, "CAMERAS", (CAMERA,))
    assert export(folder, tmp_path / "set").ok


@pytest.mark.parametrize(
    ("step", "said"),
    [
        (-HOUR, "the clock was set back"),
        pytest.param(HOUR, "its stamps jumped ahead by 3600 s", marks=pytest.mark.full),
    ],
)
def test_a_large_step_loses_no_picture(tmp_path: Path, step: int, said: str) -> None:
    folder = Stepped(3.0, ((700, step),)).record(tmp_path / "e")
    recorded = episode_reader.read(folder)
    assert recorded.complete, recorded.manifest["reason"]
    parts = recorded.parts(CAMERA)
    assert [part.name for part in parts] == [CAMERA, f"{CAMERA}.2"]
    assert sum(len(part.frames) for part in parts) == 1500 // 25 - 2, "the last is on its way"
    (change,) = recorded.manifest["camera_streams"][CAMERA]["changes"]
    assert change == f"{said}: goes on in {CAMERA}.2"


def test_in_lock_step_the_clock_does_not_matter(tmp_path: Path) -> None:
    whole = datasets_synthetic.record(tmp_path / "a", 1, 0.7, (CAMERA,))
    before = export(whole, tmp_path / "before")
    datasets_synthetic.edit(whole, segments=[{"begin_ns": 1, "step_ns": 10**9}])
    after = export(whole, tmp_path / "after")
    assert (after.ok, after.frames) == (True, before.frames)
    assert after.warnings == before.warnings


def refused(folder: Path, out: Path) -> str:
    with pytest.raises(ExportError) as caught:
        export(folder, out)
    return str(caught.value)


def test_what_cannot_be_told_is_refused(tmp_path: Path) -> None:
    made = Stepped(4.0, ((600, HOUR),), machines=2)
    two = made.record(tmp_path / "two")
    assert "not known which of their clocks was set" in refused(two, tmp_path / "out")
    datasets_synthetic.edit(two, run={"robot": "ur5e"})
    killed = datasets_synthetic.copy(two, tmp_path / "killed")
    (step,) = json.loads((killed / "manifest.json").read_text())["segments"]
    bare = {key: step[key] for key in ("begin_ns", "step_ns")}
    datasets_synthetic.edit(killed, segments=[bare])  # as a recovery knows it
    assert "it is not known which rows lie on which side" in refused(killed, tmp_path / "out")
    short = [{**step, "begin_ns": START_NS + k * 10**9} for k in range(1, 6)]
    short = [{**each, "step_ns": 10**8} for each in short]
    datasets_synthetic.edit(killed, segments=short, stopped_ns=START_NS + 6 * 10**9)
    assert "no segment between" in refused(killed, tmp_path / "out")
    other = Stepped(4.0, ((600, HOUR),), sender_is_set=False).record(tmp_path / "other")
    text = refused(other, tmp_path / "out")
    assert "3600.000 s from their reception" in text and "cannot be told on which side" in text


def test_the_sync_report_judges_the_segment(tmp_path: Path) -> None:
    folder = Stepped(6.0, ((1000, -HOUR),)).record(tmp_path / "e")
    found = sync_report.write(folder)
    assert found["verdict"] == "fail"
    assert "the wall clock was set by -3600.000 s while it was recorded" in found["reasons"]
    assert found["segment"]["verdict"] == "cannot_tell", "squares do not move like instruments"
    assert "number 2, the longest" in found["segment"]["said"]
    assert found["skew_s"]["p95"] < 0.002 and found["skew_s"]["max"] < 0.1, "of one side only"
    assert export(folder, tmp_path / "set").ok, "the segment did not fail"
    text = (folder / "sync.json").read_text()
    found["segment"]["verdict"] = "fail"
    (folder / "sync.json").write_text(json.dumps(found))
    assert "--allow unsynchronised" in refused(folder, tmp_path / "other")
    assert "cannot_tell" in text


def test_a_segment_counts_frames_that_were_dropped() -> None:
    step = {"begin_ns": 10**12 + 10 * 10**9, "step_ns": -(10**9), "rows": {"t": 50}}
    manifest = {"mode": "freerun", "started_ns": 10**12, "stopped_ns": 10**12 + 60 * 10**9}
    found = clock_segments.longest({**manifest, "segments": [{**step, "frames": {"cam": 100}}]})
    assert found is not None and found.number == 2
    late = np.full(60, 10**12 + 30 * 10**9)
    assert np.flatnonzero(found.rows("cam", late, 0)).tolist() == []
    lost = np.repeat([0, 60], 30)  # 60 frames were dropped before the 31st
    assert np.flatnonzero(found.rows("cam", late, lost)).tolist() == list(range(42, 60))
    assert found.rows("t", late).sum() == 60 - 52
    with pytest.raises(EpisodeError, match="not known which rows"):
        clock_segments.longest({**manifest, "segments": ["x"]})
