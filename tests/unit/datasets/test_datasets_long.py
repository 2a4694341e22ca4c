"""Long recordings: memory for the used rows only, and several episodes where one is too long."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.recording import dataset_readers, datasets_synthetic
from helpers.recording.datasets_synthetic import FRAME_NS
from surg_recording import datasets
from surg_recording.datasets import ExportOptions
from surg_recording.datasets.formats.lerobot_part import LeRobotExporter
from surg_recording.datasets.frames.arm_motion import unwrapped
from surg_recording.datasets.frames.resample import around, linear
from surg_recording.datasets.frames.sampling import sample
from surg_recording.datasets.inspection import inspect
from surg_recording.episode import episode_reader
from surg_recording.episode.checked import long_table

SERIAL = ExportOptions(executor="serial", splits={"train": 0.5, "val": 0.5})


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("long")
    first = datasets_synthetic.record(root / "a", 1, 2.2)
    return [first, datasets_synthetic.copy(first, root / "b", seed=2)]


@pytest.fixture
def one_second(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recordings above one second are too long for an episode."""
    monkeypatch.setattr(LeRobotExporter, "longest_s", 1.0)


@pytest.mark.parametrize("format_name", ["lerobot", "lerobot_v30"])
@pytest.mark.usefixtures("one_second")
def test_a_long_recording_becomes_several_episodes_without_a_frame_lost(
    format_name: str, recordings: list[Path], tmp_path: Path
) -> None:
    exporter = datasets.load(format_name)
    dry = datasets.dry_run(exporter, recordings, SERIAL, lambda part, words: None)
    report = exporter.write(recordings, tmp_path / "set", SERIAL)
    assert report.ok, report
    assert (dry.recordings, dry.frames) == (report.recordings, report.frames)
    assert dry.recordings == 6
    for each in (dry, report):
        assert len([text for text in each.warnings if "3 episodes" in text]) == 2
    wrong, total = dataset_readers.misplaced(tmp_path / "set", format_name, [1] * 6)
    assert (wrong, total) == (0, 2 * report.frames)
    frames = list(dataset_readers.frames(tmp_path / "set", format_name))
    times = np.array([frame.grid_ns for frame in frames if frame.episode < 3])
    np.testing.assert_array_equal(np.diff(times), FRAME_NS)
    lengths = [sum(frame.episode == n for frame in frames) for n in range(6)]
    assert max(lengths) <= 20
    stated = json.loads((tmp_path / "set/surg_export.json").read_text())
    assert [r["piece"] for r in stated["recordings"]] == ["1 of 3", "2 of 3", "3 of 3"] * 2
    assert stated["splits"] == {"train": [0, 3], "val": [3, 6]}, "no recording in two splits"
    again = exporter.write(recordings, tmp_path / "set", SERIAL)
    assert again.facts["up_to_date"]


def test_pieces_hold_every_frame_once(recordings: list[Path]) -> None:
    sampled = sample(inspect(recordings[0], SERIAL), SERIAL)
    assert sampled.pieces(None) == sampled.pieces(1000.0) == [sampled]
    for longest in (1.0, 1.3, 2.0):
        pieces = sampled.pieces(longest)
        assert max(piece.grid.frames for piece in pieces) <= longest * 20
        times = np.concatenate([piece.grid.times_ns for piece in pieces])
        np.testing.assert_array_equal(times, sampled.grid.times_ns)
        for name, values in sampled.columns.items():
            joined = np.concatenate([piece.columns[name] for piece in pieces])
            np.testing.assert_array_equal(joined, values)


def test_a_long_table_gives_the_rows_that_a_whole_one_has(recordings: list[Path]) -> None:
    recorded = episode_reader.read(recordings[0])
    whole = recorded.cycle("PSM1")
    table = long_table.read(recorded, "cycle_PSM1")
    few = {"stamp_ns", "homed", "command", "accepted", "roll", "roll_goal", "roll_set"}
    assert set(table.index.columns) == few, "memory per row grows with these"
    per_row = sum(table.index[name].itemsize for name in few)
    assert per_row <= 42, "6 MiB for 5 minutes, beside 500 bytes of text per row"
    rng = np.random.default_rng(1)
    times = np.sort(rng.integers(whole["stamp_ns"][0], whole["stamp_ns"][-1], 40))
    rows = around(table.index["stamp_ns"], times)
    part = table.at(rows, ["p_tip_x", "q3"])
    np.testing.assert_array_equal(part["stamp_ns"], table.index["stamp_ns"][rows])
    assert len(part) <= 82
    for name in ("p_tip_x", "q3"):
        expected, _ = linear(whole["stamp_ns"], whole[name][:, None], times, "x", FRAME_NS)
        found, _ = linear(part["stamp_ns"], part[name][:, None], times, "x", FRAME_NS)
        np.testing.assert_array_equal(found, expected)


def test_a_value_in_a_row_that_is_not_used_is_still_checked(
    recordings: list[Path], tmp_path: Path
) -> None:
    folder = datasets_synthetic.copy(recordings[0], tmp_path / "broken")
    path = folder / "cycle_PSM1.csv"
    lines = path.read_text().splitlines()
    place = lines[0].split(",").index("q2")
    fields = lines[707].split(",")
    lines[707] = ",".join([*fields[:place], "1e308", *fields[place + 1 :]])
    path.write_text("\n".join(lines) + "\n")
    datasets_synthetic.restate(folder)
    with pytest.raises(datasets.ExportError, match=r"column q2: 1e\+308 is too large"):
        datasets.load("act").write([folder], tmp_path / "set", SERIAL)


def test_angles_are_unwrapped_at_some_rows_as_at_all() -> None:
    rng = np.random.default_rng(2)
    angles = np.cumsum(rng.normal(0, 0.8, 5000))
    wrapped = (angles + np.pi) % (2 * np.pi) - np.pi
    rows = np.unique(rng.integers(0, 5000, 300))
    for chosen in (rows, np.array([0]), np.arange(5000)):
        expected = np.unwrap(wrapped)[chosen]
        np.testing.assert_allclose(unwrapped(wrapped, chosen), expected, atol=1e-9)
