"""Episode folders: whole or not at all, readable for ever, mended after a kill."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.recording import camera_recording
from helpers.recording import recording_synthetic as synthetic
from helpers.results.recording_results import note
from surg_recording.episode import episode_reader, finishing, provenance, table_columns
from surg_recording.episode.episode_writer import EpisodeWriter
from surg_recording.episode.recovery import recover
from surg_recording.recording_errors import EpisodeError


def test_what_goes_in_comes_out(tmp_path: Path) -> None:
    what = synthetic.Synthetic(seconds=1.0, frames=20)
    folder = synthetic.record(tmp_path / "episode", what)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["episode"]
    recorded = episode_reader.read(folder)
    assert recorded.complete
    assert recorded.manifest["format"] == "surg_episode/1"
    assert recorded.arms == ["PSM1"]
    cycle, truth = recorded.cycle("PSM1"), recorded.ground_truth("PSM1")
    assert truth is not None
    assert len(cycle) == len(truth) == 600
    for tick in (1, 77, 600):
        sent = synthetic.cycle(what, tick, 1 if 50 < tick <= 550 else 0)
        assert cycle["stamp_ns"][tick - 1] == tick * synthetic.TICK_NS
        assert cycle.vector("p_tip")[tick - 1].tolist() == sent.p_tip
        assert cycle.joints("q")[tick - 1].tolist() == sent.q
        assert cycle.vector("q_br", "xyzw")[tick - 1].tolist() == list(sent.q_br)
        assert cycle["state"][tick - 1] == sent.state
        assert truth["tip_x"][tick - 1] == synthetic.ground_truth(what, tick).arms[0].tip.x
    assert cycle.columns == table_columns.cycle(6)
    assert recorded.video("endoscope_left").frames["stamp_ns"][19] == 500 * synthetic.TICK_NS
    entry = recorded.manifest["tables"]["cycle_PSM1"]
    assert entry["rate_hz"] == pytest.approx(500.0)
    assert (entry["rows"], entry["gaps"], entry["missing_ticks"]) == (600, 0, 0)
    with pytest.raises(ValueError, match="read-only"):
        cycle["tick"][0] = 7


def test_a_task_and_its_assistant_are_recorded(tmp_path: Path) -> None:
    recording = camera_recording.start(tmp_path / "episode", "lockstep", arms=["PSM1"], cameras=())
    names = ["state", "tip[3]", "nodes[2,3]"]
    for tick in (25, 50):
        values = [tick / 3.0, *(tick / np.arange(1, 10))]
        head = synthetic.header(tick * synthetic.TICK_NS)
        recording.task_state(
            SimpleNamespace(
                header=head, tick=tick, names=names, values=values, phase="a, b", done=tick == 50,
                success=True, reward=0.1, reason="",
            ), 7,
        )  # fmt: skip
        joints = SimpleNamespace(header=head, position=[0.1, 0.2, 0.3, tick / 7.0])
        recording.command("assistant", "servo_jp", joints, "/assistant_expert", 8)
        jaw = SimpleNamespace(header=head, position=[0.4])
        recording.command("assistant", "jaw/servo_jp", jaw, "/assistant_expert", 9)
    recording.cycle("PSM1", synthetic.cycle(synthetic.Synthetic(), 50, 0), 7)
    recorded = episode_reader.read(recording.close({}))
    assert recorded.complete, recorded.manifest["reason"]
    task, said = recorded.table("task_state"), recorded.table("command_assistant")
    assert task["tick"].tolist() == [25, 50]
    assert task["phase"].tolist() == ["a, b", "a, b"]
    assert task["done"].tolist() == [0, 1]
    assert task["task.state"].tolist() == [25 / 3.0, 50 / 3.0]
    assert task["task.tip_1"][1] == 50 / 2
    assert task["task.nodes_1_2"][1] == 50 / 9
    assert len(task.columns) == len(table_columns.TASK) + 10
    assert said["topic"].tolist() == ["servo_jp", "jaw/servo_jp"] * 2
    assert said["roll"][2] == 50 / 7.0 and said["jaw"][3] == 0.4


def test_a_task_state_that_fits_no_table_makes_it_incomplete(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nodes\[\]"):
        table_columns.task(["nodes[]"])
    recording = camera_recording.start(tmp_path / "episode", "lockstep", cameras=())
    head = synthetic.header(50)
    for values in ([1.0], [1.0, 2.0]):
        recording.task_state(
            SimpleNamespace(
                header=head, tick=25, names=["tip[1]"], values=values, phase="", done=False,
                success=False, reward=0.0, reason="",
            ), 7,
        )  # fmt: skip
    recorded = episode_reader.read(recording.close({}))
    assert not recorded.complete
    assert "another number of values" in recorded.manifest["reason"]


def test_names_are_listed_when_one_is_wrong(tmp_path: Path) -> None:
    recorded = episode_reader.read(
        synthetic.record(tmp_path / "episode", synthetic.Synthetic(seconds=0.1))
    )
    with pytest.raises(EpisodeError, match=r"no table 'cycle_PSM2'; there are .*cycle_PSM1"):
        recorded.cycle("PSM2")
    with pytest.raises(EpisodeError, match="no column 'speed'; it has stamp_ns"):
        recorded.cycle("PSM1")["speed"]
    with pytest.raises(EpisodeError, match="no video 'left'; there are none"):
        recorded.video("left")


@pytest.mark.parametrize(
    ("manifest", "said"),
    [
        (None, "manifest.json is missing"),
        ("{", "not valid JSON"),
        ("[]", "format is None"),
        ('{"format": "surg_episode/99"}', "format is 'surg_episode/99'; this version reads"),
        ('{"format": "surg_episode/1", "videos": {}}', "key 'tables' is missing"),
    ],
)
def test_what_is_no_episode_is_refused(tmp_path: Path, manifest: str | None, said: str) -> None:
    if manifest is not None:
        (tmp_path / "manifest.json").write_text(manifest)
    with pytest.raises(EpisodeError, match=said):
        episode_reader.read(tmp_path)


def test_an_unfinished_folder_is_refused_with_the_cure(tmp_path: Path) -> None:
    recording = camera_recording.start(tmp_path / "e", "lockstep", cameras=())
    with pytest.raises(EpisodeError, match=r"never finished.*recover"):
        episode_reader.read(recording.folder)
    recording.close({})
    assert episode_reader.read(tmp_path / "e").complete


def test_a_long_table_is_described_without_being_held(tmp_path: Path) -> None:
    """A recording of 30 minutes has 900,000 lines of 590 bytes; its recorder must not hold them."""
    path, rows = tmp_path / "cycle_PSM1.csv", 20_000
    with open(path, "w") as file:
        file.write("stamp_ns,receive_ns,tick,q0\n")
        file.writelines(f"{2_000_000 * n},{n},{n},{'7' * 560}\n" for n in range(rows))
    tracemalloc.start()
    entry = finishing.describe_table(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    print(f"{peak / rows:.0f} bytes per row")
    assert (entry["rows"], entry["last_stamp_ns"], entry["missing_ticks"]) == (
        rows,
        2_000_000 * (rows - 1),
        0,
    )
    assert peak / rows < 200


def test_a_taken_name_gets_a_number(tmp_path: Path) -> None:
    made = [EpisodeWriter(tmp_path / "e", {}, 0) for _ in range(3)]
    names = [writer.finalise({}, {}, None).name for writer in made]
    assert names == ["e", "e_2", "e_3"]


def test_too_little_space_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="MiB free, recording needs at least"):
        EpisodeWriter(tmp_path / "e", {}, 1 << 60)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EpisodeError, match="cannot record here"):
        EpisodeWriter(tmp_path / "file" / "e", {}, 0)


def test_missing_ticks_drops_and_absent_streams_make_it_incomplete(tmp_path: Path) -> None:
    what = synthetic.Synthetic()
    recording = camera_recording.start(tmp_path / "e", arms=["PSM1", "PSM2"])
    for tick in (1, 2, 5):
        recording.cycle("PSM1", synthetic.cycle(what, tick, 1), tick)
    other = synthetic.Synthetic(joints=7)
    recording.cycle("PSM1", synthetic.cycle(other, 6, 1), 6)
    recorded = episode_reader.read(recording.close({}))
    assert recorded.manifest["tables"]["cycle_PSM1"]["missing_ticks"] == 2
    assert recorded.manifest["tables"]["cycle_PSM1"]["gap_max_s"] == pytest.approx(0.006)
    for reason in ("cam: no image", "PSM2: no cycle", "another number of joints", "1 dropped"):
        assert reason in recorded.manifest["reason"]


def test_a_full_disk_ends_the_recording_and_keeps_what_was_there(tmp_path: Path) -> None:
    what = synthetic.Synthetic()
    recording = camera_recording.start(tmp_path / "e", arms=["PSM1"], cameras=())
    for tick in range(1, 101):
        recording.cycle("PSM1", synthetic.cycle(what, tick, 1), tick)
    recording.tables.writer.flush(2.0)
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, recording.tables.all()["cycle_PSM1"]._fd)
    os.close(full)
    recording.cycle("PSM1", synthetic.cycle(what, 101, 1), 101)
    deadline = time.monotonic() + 2.0
    while not recording.failed and time.monotonic() < deadline:
        time.sleep(0.01)
    assert recording.failed
    recorded = episode_reader.read(recording.close({}))
    assert not recorded.complete
    assert "No space left" in recorded.manifest["reason"]
    assert list(recorded.cycle("PSM1")["tick"]) == list(range(1, 101))


_VICTIM = """
import sys, time
from pathlib import Path
from helpers.recording import recording_synthetic as synthetic
from surg_recording.episode.episode_recorder import Recording
what = synthetic.Synthetic()
r = Recording(Path(sys.argv[1]), mode="lockstep", arms=["PSM1"], cameras=["cam"],
              manifest={"run": {"robot": "ur5e"}}, min_free_bytes=0)
print("go", flush=True)
k = 0
while True:
    k += 1
    r.cycle("PSM1", synthetic.cycle(what, k, 1), time.monotonic_ns())
    r.ground_truth(synthetic.ground_truth(what, k), time.monotonic_ns())
    if k % 25 == 0:
        r.image("cam", synthetic.image(k * 2_000_000, k // 25), time.monotonic_ns())
    time.sleep(0.002)
"""


@pytest.mark.timed
def test_a_killed_recorder_is_mended_at_the_next_start(tmp_path: Path, full: bool) -> None:
    rng = np.random.default_rng(3)
    kills, rows_ms, video_s = (20 if full else 2), 0.0, 0.0
    for kill in range(kills):
        folder = tmp_path / f"e{kill}"
        path = [*sys.path, str(Path(__file__).parents[2])]
        with subprocess.Popen(
            [sys.executable, "-c", _VICTIM, str(folder)],
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path)},
        ) as victim:
            assert victim.stdout is not None
            victim.stdout.readline()
            time.sleep(rng.uniform(1.0, 2.0))
            assert recover(tmp_path) == [], "a living recorder's folder must be left alone"
            killed = time.monotonic_ns()
            os.kill(victim.pid, signal.SIGKILL)
        deadline = time.monotonic() + 30.0
        while not (done := recover(tmp_path)) and time.monotonic() < deadline:
            time.sleep(0.02)  # the encoder still finishes its file
        assert done == [folder]
        recorded = episode_reader.read(folder)
        assert not recorded.complete
        assert "killed" in recorded.manifest["reason"]
        assert recorded.manifest["run"] == {"robot": "ur5e"}
        cycle = recorded.cycle("PSM1")
        assert np.array_equal(cycle["tick"], np.arange(1, len(cycle) + 1))
        rows_ms = max(rows_ms, (killed - int(cycle["receive_ns"][-1])) * 1e-6)
        side = recorded.video("cam").frames
        video_s = max(video_s, (killed - int(side["receive_ns"][-1])) * 1e-9)
        assert rows_ms <= 50.0
        assert video_s <= 0.5
        assert not list(folder.glob(".*")) and not list(folder.glob("*.tmp"))
    result = f"≤ {rows_ms:.1f} ms of rows, ≤ {video_s:.3f} s of video lost"
    note("kill -9 of the recorder: whole episode recovered", kills, result)


def test_recover_mends_only_the_named_episode(tmp_path: Path) -> None:
    for name in ("a", "a_2", "b"):
        folder = tmp_path / f"{name}.partial"
        folder.mkdir()
        (folder / "events.csv").write_text("stamp_ns,receive_ns,topic,source,text\n1,2,/x,,hel")
    held = os.open(tmp_path / "a_2.partial" / ".lock", os.O_CREAT | os.O_RDWR)
    fcntl.flock(held, fcntl.LOCK_EX)
    assert [p.name for p in recover(tmp_path, "a")] == ["a"]
    os.close(held)
    assert [p.name for p in recover(tmp_path, "a")] == ["a_2"]
    assert len(episode_reader.read(tmp_path / "a").table("events")) == 0
    assert [p.name for p in recover(tmp_path)] == ["b"]
    assert recover(tmp_path / "nowhere") == []


def test_the_manifest_is_plain_json(tmp_path: Path) -> None:
    manifest = {
        "float": np.float64(0.5),
        "nan": float("nan"),
        "array": np.arange(2),
        "path": Path("/a"),
        "flag": np.bool_(True),
    }
    folder = EpisodeWriter(tmp_path / "e", manifest, 0).finalise({}, {}, None)
    stored = json.loads((folder / "manifest.json").read_text())
    assert [stored[key] for key in manifest] == [0.5, None, [0, 1], "/a", True]


def test_a_cell_is_described_with_every_file(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text("<robot/>")
    (tmp_path / "r.yaml").write_text("name: r\nurdf: r.urdf\nlimits: {cone: 1.0, depth_max: 0.2}\n")
    (tmp_path / "i.yaml").write_text("name: i\n")
    cell = tmp_path / "cell"
    (cell / "calibration").mkdir(parents=True)
    (cell / "cell.yaml").write_text(
        "name: c\narms:\n  PSM1: {robot: ../r.yaml, instrument: ../i.yaml, limits: {cone: 0.5}}\n"
    )
    (cell / "calibration" / "tool_PSM1.yaml").write_text("tip: [0, 0, 0.3]\n")
    found = provenance.describe_cell(cell)
    arm = found["arms"]["PSM1"]
    assert arm["limits"] == {"cone": 0.5, "depth_max": 0.2}
    assert arm["tool"] == {"tip": [0, 0, 0.3]}
    assert len(found["files"]) == 5
    assert len(found["problems"]) == 1 and "trocar_PSM1" in found["problems"][0]
    (cell / "next.yaml").write_text("tip: [0, 0, 0.4]\n")
    other = provenance.describe_cell(cell, {"PSM1": "../i.yaml next.yaml"})["arms"]["PSM1"]
    assert (other["instrument"], other["tool"]) == ({"name": "i"}, {"tip": [0, 0, 0.4]})
    assert other["mounted"] == "../i.yaml next.yaml"
    assert arm["mounted"] == "../i.yaml calibration/tool_PSM1.yaml"
    before = (found["hash"], arm["limits_hash"])
    (tmp_path / "r.yaml").write_text("name: r\nurdf: r.urdf\nlimits: {cone: 1.0, depth_max: 0.1}\n")
    again = provenance.describe_cell(cell / "cell.yaml")
    assert again["hash"] != before[0] and again["arms"]["PSM1"]["limits_hash"] != before[1]


def test_versions_name_what_computes() -> None:
    found = provenance.versions()
    for name in ("python", "numpy", "scipy", "av", "surg_recording"):
        assert found[name]


@pytest.mark.skipif(not shutil.which("git"), reason="missing: git")
def test_two_changed_source_trees_have_two_versions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = tmp_path / "code.py"
    monkeypatch.setattr(provenance, "__file__", str(code))
    assert provenance.software_version() is None
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"]
    known = []
    for words in ("init", "add .", "commit -m a"):
        code.write_text("speed = 1\n")
        subprocess.run([*git, *words.split()], check=True, capture_output=True)
    for speed in (1, 2, 3, 2):
        code.write_text(f"speed = {speed}\n")
        known.append(provenance.software_version())
    assert known[1] == known[3] and len(set(known)) == 3
    assert "-dirty-" not in str(known[0]) and "-dirty-" in str(known[1])


def test_messages_need_no_ros() -> None:
    text = finishing.utc_now()
    assert text.endswith("Z") and len(text) == 20
    stamp = SimpleNamespace(secs=1_700_000_000, nsecs=999_999_999)
    from surg_recording.episode import table_rows

    assert table_rows.nanoseconds(stamp) == 1_700_000_000_999_999_999
    assert not [name for name in sys.modules if name == "surg_recording.nodes.recorder_node"]
