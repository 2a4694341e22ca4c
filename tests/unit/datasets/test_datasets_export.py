"""Exports read back by other libraries: every frame in its place, nothing silently wrong."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from helpers.recording import dataset_readers, datasets_synthetic, felt_forces, picture_identity
from helpers.recording.dataset_readers import FORMATS
from helpers.recording.datasets_synthetic import CAMERAS, FRAME_NS, STAGES
from helpers.recording.recording_synthetic import TICK_NS, Synthetic, path
from helpers.recording.restated import edit_field, restate
from helpers.results.dataset_results import note
from surg_recording import datasets
from surg_recording.datasets import ExportError, ExportOptions, Report
from surg_recording.datasets.options import ANY_AGE_S
from surg_recording.recording_errors import EpisodeError

SERIAL = ExportOptions(executor="serial")
SECONDS = 0.7
LAST_MOVING = 50 + round(SECONDS / 0.002)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Good recordings: two successes, a recovery, a failure, one with a camera that jitters."""
    root = tmp_path_factory.mktemp("recordings")
    record = datasets_synthetic.record
    found = {
        "one": record(root / "one", 1, SECONDS),
        "failure": record(root / "failure", 2, SECONDS, success=False),
        "jitter": record(root / "jitter", 3, SECONDS, jitter_ns=20_000_000),
    }
    found["two"] = datasets_synthetic.copy(found["one"], root / "two", seed=4)
    found["recovery"] = datasets_synthetic.copy(found["one"], root / "recovery", tags=["recovery"])
    return found


def export(
    recordings: list[Path], out: Path, format_name: str = "act", options: ExportOptions = SERIAL
) -> Report:
    said: list[float | None] = []

    def progress(fraction: float | None, note: str) -> None:
        assert fraction is None or 0.0 <= fraction <= 1.0
        assert note
        said.append(fraction)

    report = datasets.load(format_name).write(recordings, out, options, progress)
    assert said
    return report


# --- what comes out -----------------------------------------------------------------------------


@pytest.mark.parametrize("format_name", FORMATS)
def test_every_frame_is_in_its_place(
    format_name: str, recordings: dict[str, Path], tmp_path: Path
) -> None:
    chosen = [recordings[name] for name in ("failure", "one", "recovery", "two")]
    report = export(chosen, tmp_path / "out", format_name)
    assert report.ok, report
    assert report.recordings == 4
    # The order of the dataset: successes, then recovery, then failure.
    wrong, total = dataset_readers.misplaced(tmp_path / "out", format_name, [1, 1, 1, 2])
    assert (wrong, total) == (0, 2 * report.frames)
    note("pictures in their place, five formats", total, "all right")
    assert report.frames > 4 * 10
    what, numbers = Synthetic(seconds=SECONDS), []
    for frame in dataset_readers.frames(tmp_path / "out", format_name):
        numbers.append((frame.episode, frame.number))
        assert frame.grid_ns % FRAME_NS == 0
        t = frame.grid_ns * 1e-9
        np.testing.assert_allclose(frame.state[:3], what.executed(t), atol=1e-7)
        after = frame.grid_ns + FRAME_NS
        if after <= LAST_MOVING * TICK_NS:  # then the command stops and the set-point counts
            np.testing.assert_allclose(frame.action[:3], path(after * 1e-9), atol=1e-7)
        else:
            np.testing.assert_allclose(frame.action[:3], what.executed(after * 1e-9), atol=1e-7)
    per_episode = report.frames // 4
    assert numbers == [(e, k) for e in range(4) for k in range(per_episode)]
    assert datasets.check(tmp_path / "out", datasets.load(format_name)).ok


def test_forces_are_the_same_in_every_format(tmp_path: Path) -> None:
    """The tip's sensor does not know its force for a while; no picture is needed to see that."""
    felt = datasets_synthetic.record(tmp_path / "felt", 1, SECONDS, felt=True)
    for format_name in FORMATS:
        out = tmp_path / format_name
        assert export([felt], out, format_name).ok
        known = set()
        for frame in dataset_readers.frames(out, format_name):
            assert frame.force is not None
            expected = felt_forces.expected(frame.grid_ns)
            np.testing.assert_allclose(frame.force, expected, atol=1e-6, err_msg=format_name)
            known.add(frame.force[3])
        assert known == {0.0, 1.0}


@pytest.mark.parametrize("format_name", FORMATS)
def test_pictures_with_a_late_clock_are_noticed(
    format_name: str, recordings: dict[str, Path], tmp_path: Path
) -> None:
    """The negative control of the test above: stamps of all pictures one frame late."""
    shifted = datasets_synthetic.copy(recordings["one"], tmp_path / "shifted")
    datasets_synthetic.shift_pictures(shifted, FRAME_NS)
    assert export([shifted], tmp_path / "out", format_name).ok, "consistent in itself"
    wrong, total = dataset_readers.misplaced(tmp_path / "out", format_name, [1])
    assert wrong == total > 0
    note("the same, a frame late", total, "all found misplaced")


def test_a_jittering_camera_gives_the_newest_picture_that_is_not_later(
    recordings: dict[str, Path], tmp_path: Path
) -> None:
    report = export([recordings["jitter"]], tmp_path / "out")
    assert report.ok
    lines = (recordings["jitter"] / "endoscope_left.csv").read_text().splitlines()[1:]
    stamps = [int(line.split(",")[1]) for line in lines]
    repeated = 0
    before = -1
    for frame in dataset_readers.frames(tmp_path / "out", "act"):
        newest = max(i for i, stamp in enumerate(stamps) if stamp <= frame.grid_ns)
        assert frame.stamps[0] == stamps[newest]
        assert picture_identity.read(frame.pictures[0]).frame == newest + 1
        repeated += newest == before
        before = newest
    stated = json.loads((tmp_path / "out" / "surg_export.json").read_text())
    assert stated["recordings"][0]["notes"]["repeated_endoscope_left"] == repeated
    print(f"jitter: {len(stamps)} pictures, {repeated} shown twice")


def test_scaled_pictures_and_a_faster_grid(recordings: dict[str, Path], tmp_path: Path) -> None:
    options = dataclasses.replace(SERIAL, fps=60, size=(48, 32), max_image_age_s=0.06)
    for format_name in ("lerobot", "diffusion_policy"):
        out = tmp_path / format_name
        assert export([recordings["one"]], out, format_name, options).ok
        what = Synthetic(seconds=SECONDS)
        for frame in dataset_readers.frames(out, format_name):
            assert frame.pictures[0].shape == (32, 48, 3)
            shown = picture_identity.read(frame.pictures[0])
            assert shown.frame == (frame.grid_ns + 1) // FRAME_NS, "held between pictures"
            t = frame.grid_ns * 1e-9
            np.testing.assert_allclose(frame.state[:3], what.executed(t), atol=2e-6)


@pytest.mark.parametrize(
    ("manifest", "kind"),
    [
        ({}, "success"),
        ({"sim": {"task": {"success": True}}}, "success"),
        ({"sim": {"task": {"success": False}}}, "failure"),
        ({"result": {"success": False}, "sim": {"task": {"success": True}}}, "failure"),
        ({"result": {"success": None}, "sim": {"task": {"success": True}}}, "success"),
        ({"tags": [{"stamp_ns": 1, "text": "recovery", "by": "/x"}]}, "recovery"),
        ({"tags": ["failure", "recovery"]}, "failure"),
        ({"tags": [{"text": "slipped once"}]}, "success"),
    ],
)
def test_kinds_of_recordings(manifest: dict[str, Any], kind: str) -> None:
    assert datasets.pipeline.inspection.kind_of(manifest) == kind


def test_splits_are_ranges_in_the_order_of_open_h(
    recordings: dict[str, Path], tmp_path: Path
) -> None:
    many = [
        datasets_synthetic.copy(recordings["one"], tmp_path / f"r{i}", seed=100 + i)
        for i in range(8)
    ]
    shares = {"train": 0.5, "val": 0.25, "test": 0.25}
    options = dataclasses.replace(SERIAL, splits=shares, cameras=CAMERAS[:1])
    mixed = [recordings["failure"], *many, recordings["recovery"]]
    report = export(mixed, tmp_path / "out", "lerobot", options)
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    assert info["splits"] == {
        "train": "0:4",
        "val": "4:6",
        "test": "6:8",
        "recovery": "8:9",
        "failure": "9:10",
    }
    stated = json.loads((tmp_path / "out/surg_export.json").read_text())
    assert [r["kind"] for r in stated["recordings"][8:]] == ["recovery", "failure"]
    assert not [text for text in report.warnings if "split" in text]


def test_lerobot_says_what_everything_is(recordings: dict[str, Path], tmp_path: Path) -> None:
    about = {"license": "CC BY 4.0", "contact": "somebody@example.org"}
    options = dataclasses.replace(SERIAL, about=about)
    out = tmp_path / "out"
    assert export([recordings["one"], recordings["failure"]], out, "lerobot", options).ok
    info = json.loads((out / "meta/info.json").read_text())
    assert list(info["features"])[:4] == [
        "observation.state",
        "action",
        "observation.images.endoscope.left",
        "observation.images.endoscope.right",
    ]
    for name in ("instruction.text", "observation.meta.tool"):
        assert info["features"][name] | {"info": None} == {
            "dtype": "string",
            "shape": [1],
            "names": ["text"],
            "info": None,
        }
    assert info["features"]["observation.state"]["names"][:2] == ["PSM1/tip_x", "PSM1/tip_y"]
    for name, feature in info["features"].items():
        stated = feature.get("info", {})
        if feature["dtype"].startswith("float") and len(feature["shape"]) and stated:
            assert len(stated["units"]) == feature["shape"][0], name
            vector = name in ("observation.state", "action", "observation.cartesian_state")
            assert bool(stated["frame"]) >= vector, name
        assert stated.get("privileged", False) == name.startswith("privileged.")
        assert "image" not in name or feature["dtype"] == "video", "lerobot's trap"
    table = pq.read_table(out / "data/chunk-000/episode_000000.parquet")
    assert set(table.column("instruction.text").to_pylist()) == {"follow the path"}
    assert set(table.column("observation.meta.tool").to_pylist()) == {"PSM1: grasper"}
    assert table.column("next.success").to_pylist() == [False] * (len(table) - 1) + [True]
    assert table.column("next.done").to_pylist() == [False] * (len(table) - 1) + [True]
    truth = np.array(table.column("privileged.task_state").to_pylist())
    ticks = np.array(table.column("timing.task_state.stamp_ns").to_pylist()) // TICK_NS
    np.testing.assert_allclose(truth[:, 0], 0.1 * ticks, rtol=1e-6)
    page = (out / "meta/README.md").read_text()
    for word in (
        "synchronization",
        "dataset description",
        "collection procedure",
        "robot",
        "sensor",
    ):
        assert word in page.lower(), "asked for by Open-H's checker"
    for fact in ("CC BY 4.0", "somebody@example.org", "ur5e", "follow the path", "simulator ticks"):
        assert fact in page
    assert "not stated" in page, "what nobody said is not made up"


def _phase_texts(recording: Path, times_ns: list[int]) -> list[str]:
    """The sentence of the phase at each time, from the task's own table."""
    rows = [line.split(",") for line in (recording / "task_state.csv").read_text().splitlines()]
    stamp, phase, done = map(rows[0].index, ("stamp_ns", "phase", "done"))
    texts = []
    for t in times_ns:
        row = [row for row in rows[1:] if int(row[stamp]) <= t][-1]
        sentence = STAGES.get(row[phase], row[phase])
        texts.append("follow the path" if row[done] == "1" else sentence)
    return texts


@pytest.mark.parametrize("version", ["lerobot_v21", "lerobot_v30"])
def test_every_row_leads_to_the_sentence_of_its_stage(
    version: str, recordings: dict[str, Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert export([recordings["one"]], out, version).ok
    info = json.loads((out / "meta/info.json").read_text())
    path = next((out / "data").rglob("*.parquet"))
    table = pq.read_table(path)
    if version == "lerobot_v21":
        column = "annotation.human.action.subtask_description"
        lines = (out / "meta/tasks.jsonl").read_text().splitlines()
        texts = [json.loads(line)["task"] for line in lines]
        modality = json.loads((out / "meta/modality.json").read_text())
        assert {f"annotation.{name}" for name in modality["annotation"]} == {
            column,
            "annotation.human.action.task_description",
        }
        assert modality["action"] == {"PSM1": {"start": 0, "end": 5}}
        assert modality["video"]["endoscope_left"] == {
            "original_key": "observation.images.endoscope.left"
        }
        task = table.column("annotation.human.action.task_description").to_pylist()
        assert {texts[place] for place in task} == {"follow the path"}
    else:
        column = "subtask_index"
        rows = pq.read_table(out / "meta/subtasks.parquet").to_pylist()
        texts = [row["__index_level_0__"] for row in sorted(rows, key=lambda r: r[column])]
    assert info["features"][column] == {"dtype": "int64", "shape": [1], "names": None}
    said = [texts[place] for place in table.column(column).to_pylist()]
    assert said == _phase_texts(recordings["one"], table.column("timing.grid_ns").to_pylist())
    assert set(STAGES.values()) <= set(said)
    assert said == table.column("instruction.stage").to_pylist()
    place = table.column_names.index(column)
    wrong = pa.array([(n + 1) % len(texts) for n in table.column(column).to_pylist()])
    pq.write_table(table.set_column(place, column, wrong), path)
    assert any(column in error for error in datasets.load(version).validate(out).errors)


def test_statistics_are_those_of_the_data(recordings: dict[str, Path], tmp_path: Path) -> None:
    export([recordings["one"], recordings["failure"]], tmp_path / "a", "lerobot")
    export([recordings["one"], recordings["failure"]], tmp_path / "b", "lerobot_v30")
    lines = (tmp_path / "a/meta/episodes_stats.jsonl").read_text().splitlines()
    whole = pq.read_table(tmp_path / "b/data/chunk-000/file-000.parquet")
    stats = json.loads((tmp_path / "b/meta/stats.json").read_text())
    state = np.array(whole.column("observation.state").to_pylist(), dtype=np.float64)
    for key, value in {
        "mean": state.mean(0),
        "std": state.std(0),
        "min": state.min(0),
        "max": state.max(0),
        "q90": np.quantile(state, 0.9, axis=0),
    }.items():
        np.testing.assert_allclose(stats["observation.state"][key], value, rtol=1e-12, atol=1e-15)
    assert stats["observation.state"]["count"] == [len(whole)]
    for episode, line in enumerate(lines):
        stated = json.loads(line)["stats"]["observation.images.endoscope.left"]
        shown = [
            f.pictures[0]
            for f in dataset_readers.frames(tmp_path / "a", "lerobot")
            if f.episode == episode
        ]
        pixels = np.array(shown, dtype=np.float64).reshape(-1, 3) / 255
        for key in ("mean", "std"):  # of the recorded pictures; these have been encoded once more
            assert np.shape(stated[key]) == (3, 1, 1)
            np.testing.assert_allclose(
                np.ravel(stated[key]), getattr(pixels, key)(axis=0), atol=0.01
            )
        assert stated["count"] == [len(shown)]


def test_robomimic_next_observations_are_one_frame_on(
    recordings: dict[str, Path], tmp_path: Path
) -> None:
    export([recordings["one"], recordings["failure"]], tmp_path / "out", "robomimic")
    with h5py.File(tmp_path / "out/demos.hdf5", "r", libver="latest", swmr=True) as root:
        for demo in root["data"].values():
            assert set(demo["obs"]) == set(demo["next_obs"])
            for name, values in demo["obs"].items():
                then = demo["next_obs"][name]
                assert (then[:-1] == values[1:]).all()
                assert (then[-1] == values[-1]).all()
        names = sorted(name.decode() for mask in root["mask"].values() for name in mask)
        assert names == ["demo_0", "demo_1"]
        assert (root["data"].attrs["actions_min"] <= root["data/demo_0/actions"][0]).all()


def test_v30_tasks_have_their_words_as_pandas_index(
    recordings: dict[str, Path], tmp_path: Path
) -> None:
    export([recordings["one"]], tmp_path / "out", "lerobot_v30")
    table = pq.read_table(tmp_path / "out/meta/tasks.parquet")
    stated = json.loads(table.schema.metadata[b"pandas"])
    (index,) = stated["index_columns"]
    assert table.column(index).to_pylist() == ["follow the path"]
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_parquet(tmp_path / "out/meta/tasks.parquet")
    assert frame.iloc[0].name == "follow the path"
    assert frame.loc["follow the path"].task_index == 0


# --- what must not come out -----------------------------------------------------------------------


def drop_line(file: Path, number: int) -> None:
    lines = file.read_text().splitlines(keepends=True)
    del lines[number]
    file.write_text("".join(lines))


def without(folder: Path, key: str, **changes: Any) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["tables"][key].update(changes)
    datasets_synthetic.edit(folder, tables=manifest["tables"])


def empty(folder: Path) -> None:
    file = folder / "cycle_PSM1.csv"
    file.write_text(file.read_text().splitlines()[0] + "\n")
    without(folder, "cycle_PSM1", rows=0)


def cut_video(folder: Path) -> None:
    file = folder / "endoscope_left.mp4"
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])


def two_parts(folder: Path) -> None:
    videos = json.loads((folder / "manifest.json").read_text())["videos"]
    videos["endoscope_left.2"] = {**videos["endoscope_left"], "part_of": "endoscope_left"}
    datasets_synthetic.edit(folder, videos=videos)


def not_recorded(folder: Path) -> None:
    folder.joinpath("sync.json").write_text('{"verdict": "fail"}')


BROKEN: dict[str, tuple[Any, str]] = {
    "empty": (empty, "no control cycle of PSM1 was recorded"),
    "no sidecar": (
        lambda f: (f / "endoscope_left.csv").unlink(),
        "endoscope_left.csv: the file is missing",
    ),
    "no video": (
        lambda f: (f / "endoscope_right.mp4").unlink(),
        "endoscope_right.mp4: the file is missing",
    ),
    "torn line": (
        lambda f: (f / "cycle_PSM1.csv").write_text((f / "cycle_PSM1.csv").read_text()[:-40]),
        "fields, the header has",
    ),
    "a row is gone": (lambda f: drop_line(f / "cycle_PSM1.csv", 77), "rows, the manifest says"),
    "last rows are gone": (lambda f: drop_line(f / "task_state.csv", -1), "task_state.csv: "),
    "not a number": (
        lambda f: (edit_field(f / "cycle_PSM1.csv", 90, "p_tip_y", "nan"), restate(f)),
        "column p_tip_y: not a number",
    ),
    "a word": (lambda f: edit_field(f / "cycle_PSM1.csv", 90, "q0", "abc"), "column q0: 'abc'"),
    "edited stamp": (
        lambda f: edit_field(f / "endoscope_left.csv", 9, "stamp_ns", "460000000"),
        "endoscope_left.csv, line 10: frame, stamp_ns and pts do not fit the video",
    ),
    "stamp goes back": (
        lambda f: (edit_field(f / "cycle_PSM1.csv", 90, "stamp_ns", "1"), restate(f)),
        "line 91: stamp_ns 1 is earlier",
    ),
    "cut video": (cut_video, "frames can be read, its sidecar endoscope_left.csv lists"),
    "another robot": (
        lambda f: datasets_synthetic.edit(
            f,
            cell={
                "arms": {"PSM1": {"robot": {"name": "panda"}, "instrument": {"name": "grasper"}}}
            },
        ),
        "robots: panda, but this export has ur5e",
    ),
    "incomplete": (
        lambda f: datasets_synthetic.edit(f, outcome="incomplete", reason="disk full"),
        "the recording is incomplete: disk full; --allow incomplete",
    ),
    "sync report fails": (not_recorded, "--allow unsynchronised"),
    "no manifest that can be read": (
        lambda f: (f / "manifest.json").write_text('{"format": '),
        "not valid JSON",
    ),
    "a newer format": (
        lambda f: datasets_synthetic.edit(f, format="surg_episode/9"),
        "surg_episode/9",
    ),
    "the clock was set": (
        lambda f: datasets_synthetic.edit(
            f, mode="freerun", segments=[{"begin_ns": 1, "step_ns": 10**9}]
        ),
        "the clock was set 1 times",
    ),
    "a camera in two parts": (two_parts, "endoscope_left has more than one video"),
    "the same once more": (lambda f: None, "the same recording as"),
}


def test_broken_recordings_are_refused_by_name_and_the_rest_goes_on(
    recordings: dict[str, Path], tmp_path: Path
) -> None:
    folders = [recordings["one"]]
    for name, (spoil, _) in BROKEN.items():
        changes = {} if name == "the same once more" else {"seed": name}
        folders.append(datasets_synthetic.copy(recordings["one"], tmp_path / name, **changes))
        spoil(folders[-1])
    killed = shutil.copytree(recordings["one"], tmp_path / "killed.partial")
    folders += [killed, recordings["two"]]
    report = export(folders, tmp_path / "out", "lerobot")
    assert report.recordings == 2
    assert not report.ok
    assert not report.errors
    assert set(report.refused) == {str(folder) for folder in folders[1:-1]}
    for name, (_, said) in BROKEN.items():
        reason = report.refused[str(tmp_path / name)]
        assert said in reason, (name, reason)
        assert str(tmp_path / name) in reason or "column" in reason, "names the recording"
    assert "never finished" in report.refused[str(killed)]
    wrong, _ = dataset_readers.misplaced(tmp_path / "out", "lerobot", [1, 1])
    assert wrong == 0
    again = datasets.dry_run(datasets.load("lerobot"), folders, SERIAL, lambda fraction, note: None)
    assert again.recordings == 2
    assert set(again.refused) == set(report.refused), "a dry run finds what the export finds"
    note("broken recordings", len(report.refused), "all refused by name, the others exported")


def test_what_stalls_or_is_too_short_is_refused(tmp_path: Path) -> None:
    stalled = datasets_synthetic.record(tmp_path / "stalled", 7, 1.0, CAMERAS[:1], stall=(10, 16))
    with pytest.raises(ExportError, match=r"at most 100 ms .*--allow old-pictures"):
        export([stalled], tmp_path / "out")
    lenient = dataclasses.replace(SERIAL, max_image_age_s=ANY_AGE_S)
    assert export([stalled], tmp_path / "out", options=lenient).ok
    short = datasets_synthetic.record(tmp_path / "short", 8, 0.02, ())
    candidate = datasets.pipeline.inspection.inspect(short, SERIAL)
    assert datasets.sample(candidate, SERIAL).grid.frames >= 2
    slow = dataclasses.replace(SERIAL, fps=1)
    with pytest.raises(EpisodeError, match="overlap too shortly"):
        datasets.sample(datasets.pipeline.inspection.inspect(short, slow), slow)


def test_a_wrist_whose_turn_was_not_recorded_is_not_exported_as_straight(tmp_path: Path) -> None:
    folder = datasets_synthetic.record(tmp_path / "bent", 9, 1.0, ())
    manifest = json.loads((folder / "manifest.json").read_text())
    arm = manifest["arms"][0]
    tool = {"name": "wristed_grasper", "wrist": {"lag": 0.04}}
    manifest["cell"] = {"arms": {arm: {"instrument": tool}}}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ExportError, match=rf"bent: {arm}: .* does not hold the turn"):
        export([folder], tmp_path / "out")


def test_nothing_is_overwritten(recordings: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.txt").write_text("mine")
    with pytest.raises(ExportError, match="holds something that is no export"):
        export([recordings["one"]], out)
    (out / "thesis.txt").unlink()
    assert export([recordings["one"]], out).ok
    with pytest.raises(ExportError, match="--replace"):
        export([recordings["two"]], out)
    with pytest.raises(ExportError, match="--replace"):
        export([recordings["one"]], out, "lerobot")
    report = export([recordings["two"]], out, options=dataclasses.replace(SERIAL, replace=True))
    assert report.ok
    assert report.made == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"], "no parts, nothing unfinished"
    with pytest.raises(ExportError, match="no such folder"):
        export([tmp_path / "nowhere"], out)
    (tmp_path / "bare").mkdir()
    with pytest.raises(ExportError, match=r"no episode .* name folders"):
        export([tmp_path / "bare"], out)


def test_damage_to_an_export_is_found(recordings: dict[str, Path], tmp_path: Path) -> None:
    for format_name in FORMATS:
        out = tmp_path / format_name
        export([recordings["one"]], out, format_name)
        files = [p for p in out.rglob("*") if p.is_file() and p.name != "surg_export.json"]
        largest = max(files, key=lambda p: p.stat().st_size)
        data = bytearray(largest.read_bytes())
        data[len(data) // 2] ^= 0xFF
        largest.write_bytes(data)
        report = datasets.check(out, datasets.load(format_name))
        assert any("changed since it was written" in text for text in report.errors)
        largest.write_bytes(data[: len(data) // 2])
        with pytest.raises(ExportError, match="missing or changed"):
            export([recordings["one"]], out, format_name)


def test_what_an_encoder_gets_wrong_is_found(
    recordings: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames that are swapped, lost or doubled on the way into a video."""
    from surg_recording.datasets import pictures

    right = pictures.encode

    def spoiled(order: Any) -> Any:
        def encode(frames: Any, path: Path, how: ExportOptions) -> int:
            given = [frame.reformat(format="rgb24") for frame in frames]
            return right(order(given), path, how)

        return encode

    for order, said in (
        (lambda f: [f[1], f[0], *f[2:]], "shows another picture"),
        (lambda f: f[:-1], "frames were written"),
        (lambda f: [*f, f[-1]], "more than the"),
    ):
        monkeypatch.setattr(pictures, "encode", spoiled(order))
        with pytest.raises(ExportError, match=said):
            export([recordings["one"]], tmp_path / "out", "lerobot")
    assert not (tmp_path / "out").exists()


def test_wrong_options_are_named() -> None:
    for key, value in {
        "fps": 0,
        "crf": 52,
        "gop": 0,
        "size": (641, 480),
        "executor": "magic",
        "splits": {"train": 0.5},
        "shard": (2, 2),
        "workers": 0,
        "max_image_age_s": 0.0,
    }.items():
        with pytest.raises(ValueError, match="is not allowed; allowed: "):
            ExportOptions(**{key: value})
    with pytest.raises(ExportError, match="there are lerobot, lerobot_v21"):
        datasets.load("nonsense")


def test_dropping_features(recordings: dict[str, Path], tmp_path: Path) -> None:
    drop = ("observation.images.endoscope.right", "observation.meta.tool", "privileged.task_state")
    options = dataclasses.replace(SERIAL, drop=drop)
    assert export([recordings["one"]], tmp_path / "out", "lerobot", options).ok
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    assert not set(drop) & set(info["features"])
    assert not [name for name in info["features"] if "endoscope_right" in name]
    with pytest.raises(ExportError, match=r"--drop observation.meta.toll: no such feature"):
        options = dataclasses.replace(SERIAL, drop=("observation.meta.toll",))
        export([recordings["one"]], tmp_path / "other", "lerobot", options)
