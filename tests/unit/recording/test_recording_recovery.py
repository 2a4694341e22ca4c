"""Recovery: whatever a kill or a power cut leaves, what is finished is whole and true."""

from __future__ import annotations

import fcntl
import json
import os
import random
import shutil
from pathlib import Path

import pytest

from helpers.recording import recording_synthetic as synthetic
from helpers.results.recording_results import note
from surg_recording.clock import clock_segments
from surg_recording.episode import episode_reader, finishing, recovery, table_file
from surg_recording.episode.episode_writer import LOCK, EpisodeWriter
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import mp4_boxes, video_file
from surg_recording.video.image_frame import frame_of
from surg_recording.video.video_sink import VideoSink


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished video of 60 frames at 20 fps with its sidecar."""
    folder = tmp_path_factory.mktemp("video")
    sink = VideoSink(folder, "cam", block=True)
    for k in range(60):
        image = synthetic.image(k * 50_000_000 + 1, k)
        sink.put(frame_of(image, k * 50_000_000 + 1, k))
    sink.close()
    assert sink.error is None
    return folder


def test_boxes_tell_what_a_decoder_finds(video: Path) -> None:
    found = mp4_boxes.fragments(video / "cam.mp4")
    assert sum(fragment.frames for fragment in found) == 60
    assert max(fragment.frames for fragment in found) <= 5, "0.2 s and a frame at most"
    assert mp4_boxes.is_closed(video / "cam.mp4")


def test_a_video_cut_anywhere_is_mended_to_its_last_whole_fragment(
    video: Path, tmp_path: Path, rng: random.Random, full: bool
) -> None:
    whole, lines = (video / "cam.mp4").read_bytes(), (video / "cam.csv").read_text()
    ends = mp4_boxes.fragments(video / "cam.mp4")
    cuts = 400 if full else 60
    path, sidecar = tmp_path / "cam.mp4", tmp_path / "cam.csv"
    for number in range(cuts):
        size = rng.randrange(len(whole) + 1)
        zeros = bytes(rng.randrange(5000)) if number % 3 == 0 else b""  # a power cut
        path.write_bytes(whole[:size] + zeros)
        sidecar.write_text(lines[: rng.randrange(len(lines))] if number % 2 else lines)
        stamps = max(0, sidecar.read_text().count("\n") - 1)
        in_file = sum(f.frames for f in ends if f.end <= size)
        kept = video_file.mend(path, sidecar)
        side = table_file.read_table(sidecar)
        assert kept == len(side) <= min(in_file, stamps)
        assert kept > min(in_file, stamps) - 5, "no more than one fragment goes with the cut"
        if kept:
            assert video_file.presentation_times(path) == side["pts"].tolist()
            assert len(video_file.grab(path, list(range(kept)))) == kept
        assert video_file.mend(path, sidecar) == kept, "mending again changes nothing"
    note("video cut at a random byte", cuts, "every whole fragment with a stamp kept, all readable")


def test_f12_mending_takes_no_room(
    tmp_path: Path, video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk is when encoders fail: lines without a frame are cut in place."""
    path, sidecar = tmp_path / "cam.mp4", tmp_path / "cam.csv"
    shutil.copy(video / "cam.mp4", path)
    shutil.copy(video / "cam.csv", sidecar)
    frames = len(video_file.presentation_times(path))
    whole = sidecar.read_bytes()
    with open(sidecar, "ab") as file:
        file.write(whole.splitlines(True)[-1] * 3 + b"7,")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(video_file.os, "replace", full)
    assert video_file.mend(path, sidecar) == frames
    assert sidecar.read_bytes() == whole


def test_a_table_cut_or_zeroed_anywhere_keeps_its_whole_lines(
    tmp_path: Path, rng: random.Random
) -> None:
    text = "stamp_ns,x,text\n" + "".join(f'{k},{k / 7!r},"a, {k}"\n' for k in range(50))
    data = text.encode()
    path = tmp_path / "t.csv"
    for number in range(200):
        size = rng.randrange(16, len(data) + 1)
        path.write_bytes(data[:size] + bytes(rng.randrange(9000)) * (number % 2))
        os.truncate(path, finishing.whole_lines(path))
        table = table_file.read_table(path)
        assert len(table) == data[:size].count(b"\n") - 1
        assert table["stamp_ns"].tolist() == list(range(len(table)))


def unfinished(folder: Path, video: Path) -> Path:
    """A killed recording of one arm and one camera."""
    writer = EpisodeWriter(folder, {"arms": ["PSM1"], "run": {"operator": "A"}}, 0)
    os.close(writer.lock)
    text = "stamp_ns,receive_ns,tick\n" + "".join(f"{k},{k},{k}\n" for k in range(1, 40))
    (writer.folder / "cycle_PSM1.csv").write_text(text + "40,4")
    for name in ("cam.mp4", "cam.csv"):
        shutil.copy(video / name, writer.folder / name)
    with open(writer.folder / "cam.mp4", "rb+") as file:
        file.truncate(mp4_boxes.fragments(video / "cam.mp4")[5].end + 100)
    (writer.folder / "manifest.json.tmp").write_text("{")
    (writer.folder / "empty.csv").write_text("")
    said = '1,2,/record/tag,/c,"{""stage"": ""cut""}"\n5,6,/record/tag,/c,oops\n7,8,/record'
    (writer.folder / "events.csv").write_text("stamp_ns,receive_ns,topic,source,text\n" + said)
    (writer.folder / "topics").mkdir()
    (writer.folder / "topics" / "n.csv").write_text("stamp_ns,receive_ns,source,data\n0,1,/s,7\n0")
    about = {"topic": "/n", "type": "std_msgs/Int64", "kinds": {"data": "int", "source": "text"}}
    (writer.folder / "topics" / "n.json").write_text(json.dumps(about))
    return writer.folder


def test_what_is_recovered_says_so_and_keeps_what_it_was_told(tmp_path: Path, video: Path) -> None:
    folder = unfinished(tmp_path / "e", video)
    before = {name: (folder / name).read_bytes() for name in ("cam.mp4", "cam.csv")}
    final = recovery.recover_one(folder)
    assert final == tmp_path / "e" and not folder.exists()
    recorded = episode_reader.read(final)
    assert recorded.manifest["run"] == {"operator": "A"}
    assert recorded.manifest["outcome"] == "incomplete"
    assert "killed" in recorded.manifest["reason"] and recorded.manifest["recovered"]
    assert len(recorded.cycle("PSM1")) == 39
    frames = sum(f.frames for f in mp4_boxes.fragments(video / "cam.mp4")[:6])
    assert len(recorded.video("cam").frames) == frames
    names = sorted(path.name for path in final.iterdir() if path.suffix != ".damaged")
    files = ["cam.csv", "cam.mp4", "cycle_PSM1.csv", "events.csv", "manifest.json", "topics"]
    assert names == files
    cut = {path.name: path.read_bytes() for path in final.glob("**/*.damaged")}
    assert set(cut) == {
        *("cam.csv.damaged", "cam.mp4.damaged", "cycle_PSM1.csv.damaged", "events.csv.damaged"),
        *("manifest.json.tmp.damaged", "n.csv.damaged"),
    }
    assert cut["cycle_PSM1.csv.damaged"] == b"40,4" and cut["n.csv.damaged"] == b"0"
    assert (final / "cam.mp4").read_bytes() + cut["cam.mp4.damaged"] == before["cam.mp4"]
    assert (final / "cam.csv").read_bytes() + cut["cam.csv.damaged"] == before["cam.csv"]
    for said in ("cycle_PSM1.csv: its end was broken: 4 bytes cut, kept in", "cam.mp4: its end"):
        assert said in recorded.manifest["reason"]
    assert recorded.stages == [{"name": "cut", "begin_ns": 1, "end_ns": 5, "by": "/c"}]
    assert recorded.tags == [{"stamp_ns": 5, "text": "oops", "by": "/c"}]
    (numbers,) = recorded.topic("/n")
    assert numbers["data"].tolist() == [7]


def test_f09_a_step_of_the_clock_is_known_after_a_kill(tmp_path: Path, video: Path) -> None:
    """But not which rows came before it: such a recording is not exported."""
    folder = unfinished(tmp_path / "e", video)
    with open(folder / "events.csv", "w") as file:
        file.write("stamp_ns,receive_ns,topic,source,text\n")
        file.write("9,9,clock_step,,the wall clock stepped by -20000000 ns\n")
    recorded = episode_reader.read(recovery.recover_one(folder))
    assert recorded.segments == [{"begin_ns": 9, "step_ns": -20_000_000}]
    with pytest.raises(EpisodeError, match="not known which rows lie on which side"):
        clock_segments.longest({**recorded.manifest, "mode": "freerun"})


def test_a_recovery_that_is_killed_can_be_repeated(tmp_path: Path, video: Path) -> None:
    folder = unfinished(tmp_path / "e", video)
    finishing.complete(folder, {"format": episode_reader.FORMAT}, {}, "first try")
    assert folder.name.endswith(".partial")
    recorded = episode_reader.read(recovery.recover_one(folder))
    assert len(recorded.cycle("PSM1")) == 39


def test_a_manifest_that_is_gone_costs_the_facts_only(tmp_path: Path, video: Path) -> None:
    folder = unfinished(tmp_path / "e", video)
    (folder / "manifest.json").write_text('{"format": "surg_ep')
    recorded = episode_reader.read(recovery.recover_one(folder))
    assert recorded.arms == ["PSM1"] and len(recorded.cycle("PSM1")) == 39


def test_a_hand_edited_table_and_a_missing_sidecar_are_named(tmp_path: Path, video: Path) -> None:
    folder = unfinished(tmp_path / "e", video)
    (folder / "cam.csv").unlink()
    (folder / "events.csv").write_text("stamp_ns,receive_ns,topic,source,text\nnow,then,/x,,y\n")
    recorded = episode_reader.read(recovery.recover_one(folder))
    assert "cam.mp4: its sidecar is missing" in recorded.manifest["reason"]
    assert "events: a line's stamp is no integer" in recorded.manifest["reason"]
    assert (recorded.folder / "cam.mp4").exists(), "nothing recorded is thrown away"
    assert recorded.cameras == []


def test_nothing_that_was_recorded_is_deleted(tmp_path: Path, video: Path) -> None:
    """Files of which nothing can be used are set aside, and what is lost is named."""
    folder = unfinished(tmp_path / "e", video)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest.update(cameras=["cam", "other"], arms=["PSM1", "PSM2"])
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / "cam.mp4").write_bytes(b"no video at all, but something")
    broken = b"\0" * 10 + (folder / "cycle_PSM1.csv").read_bytes()
    (folder / "cycle_PSM1.csv").write_bytes(broken)
    recorded = episode_reader.read(recovery.recover_one(folder))
    reason = recorded.manifest["reason"]
    assert "cam: no frame can be read; kept as cam.mp4.damaged, cam.csv.damaged" in reason
    assert "other: no frame is left" in reason and "PSM2: no control cycle is left" in reason
    assert "cycle_PSM1.csv: no line of it is whole; kept as cycle_PSM1.csv.damaged" in reason
    assert (recorded.folder / "cycle_PSM1.csv.damaged").read_bytes() == broken
    assert (recorded.folder / "cam.mp4.damaged").read_bytes().startswith(b"no video")


@pytest.mark.parametrize("text", ['{"format": "surg_ep', "[" * 100_000, '{"format": 7}', "[]"])
def test_an_unusable_manifest_is_kept_aside(tmp_path: Path, video: Path, text: str) -> None:
    folder = unfinished(tmp_path / "e", video)
    (folder / "manifest.json").write_text(text)
    recorded = episode_reader.read(recovery.recover_one(folder))
    assert (recorded.folder / "manifest.json.damaged").read_text() == text
    assert "kept as manifest.json.damaged" in recorded.manifest["reason"]
    assert recorded.cameras == ["cam"] and recorded.arms == ["PSM1"]


def test_folders_that_must_be_left_alone(tmp_path: Path, video: Path) -> None:
    held = unfinished(tmp_path / "held", video)
    lock = os.open(held / LOCK, os.O_RDWR)
    fcntl.flock(lock, fcntl.LOCK_EX)
    taken = unfinished(tmp_path / "taken", video)
    (tmp_path / "taken").mkdir()
    told: list[str] = []
    assert recovery.recover(tmp_path, on_problem=told.append) == []
    assert [text.partition(": ")[2] for text in told] == [
        "taken is there already; move one of them away"
    ]
    with pytest.raises(recovery.HeldError, match="is being recorded now"):
        recovery.recover_one(held)
    os.close(lock)
    with pytest.raises(EpisodeError, match="no unfinished recording"):
        recovery.recover_one(tmp_path)
    assert taken.exists() and held.exists()


def test_a_start_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(EpisodeError, match="No space left"):
        EpisodeWriter(tmp_path / "e", {}, 0)
    assert list(tmp_path.iterdir()) == []
