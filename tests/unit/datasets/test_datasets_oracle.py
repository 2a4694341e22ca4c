"""The programs that exports are for read them: lerobot 0.3.3, 0.4.4 and 0.6.1, robomimic 0.3.0.

Opt-in: `./surg test --tier oracle`. Each version has an environment of its own, made on first use
(needs the internet): 1.6 GB each, some minutes. With `--full` what they found is written to
docs/results/datasets.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from helpers.recording import datasets_synthetic, felt_forces
from helpers.recording.datasets_synthetic import FRAME_NS, PHASES, STAGES
from helpers.recording.oracle_reading import run
from helpers.recording.recording_synthetic import TICK_NS, Synthetic
from helpers.results.dataset_results import note
from surg_recording import datasets
from surg_recording.datasets import ExportOptions

pytestmark = pytest.mark.oracle

VERSIONS = {"0.3.3": "lerobot_v21", "0.4.4": "lerobot_v30", "0.6.1": "lerobot_v30"}
IDENTITIES = [1, 2, 3]
"""Of the recordings, in the order of the dataset."""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("recordings")
    return [
        datasets_synthetic.record(root / f"r{i}", i, 1.0 + 0.35 * i, felt=True) for i in IDENTITIES
    ]


def read(version: str, out: Path, tmp_path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Facts and every frame, as the real lerobot gives them, in random order."""
    versions, facts, *frames = run(version, "lerobot_reader.py", out, 100_000, 1, home=tmp_path)
    assert versions["lerobot"] == version
    return facts, frames


def misplaced(frames: list[dict[str, Any]]) -> int:
    """Pictures that are not those of their time: a picture says its own (frame · 50 ms)."""
    wrong = 0
    for frame in frames:
        for camera, shown in enumerate(frame["pictures"].values()):
            own = [IDENTITIES[frame["episode"]], camera, frame["grid_ns"] // FRAME_NS]
            wrong += shown != own
    return wrong


@pytest.mark.parametrize("version", VERSIONS)
def test_lerobot_gives_every_frame_right(
    version: str, recordings: list[Path], tmp_path: Path
) -> None:
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    out = tmp_path / "set"
    report = datasets.load(VERSIONS[version]).write(recordings, out, options)
    assert report.ok, report
    facts, frames = read(version, out, tmp_path)
    assert (facts["episodes"], facts["frames"], facts["fps"]) == (3, report.frames, 20)
    assert facts["robot"] == "ur5e"
    assert len(frames) == report.frames
    assert misplaced(frames) == 0
    what = Synthetic()
    for frame in frames:
        assert frame["index"] == frame["asked"]
        assert frame["task"] == "follow the path"
        assert frame["tool"] == "PSM1: grasper"
        assert frame["stage"] == frame["stage_text"]
        begun = [name for begin, name in PHASES.items() if begin * TICK_NS <= frame["grid_ns"]]
        assert frame["stage"] in (STAGES.get(begun[-1], begun[-1]), "follow the path")
        assert frame["timestamp"] == pytest.approx(frame["frame"] / 20, abs=1e-6)
        what.seconds = 1.0 + 0.35 * IDENTITIES[frame["episode"]]
        expected = what.executed(frame["grid_ns"] * 1e-9)
        assert frame["state"][:3] == pytest.approx(list(expected), abs=1e-7)
        assert frame["force"] == pytest.approx(felt_forces.expected(frame["grid_ns"]), abs=1e-6)
    assert {frame["force"][3] for frame in frames} == {0.0, 1.0}, "the tip's sensor was silent"
    assert set(STAGES.values()) <= {frame["stage"] for frame in frames}
    said = f"{2 * len(frames)} pictures, 0 misplaced; forces right"
    note(f"reader lerobot {version}", len(frames), said)


@pytest.mark.parametrize("version", VERSIONS)
def test_lerobot_sees_that_pictures_are_late(
    version: str, recordings: list[Path], tmp_path: Path
) -> None:
    """The negative control: the same check must fail when all pictures are stamped a frame late."""
    late = []
    for number, folder in enumerate(recordings):
        late.append(datasets_synthetic.copy(folder, tmp_path / f"late{number}", note="late"))
        datasets_synthetic.shift_pictures(late[-1], FRAME_NS)
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    assert datasets.load(VERSIONS[version]).write(late, tmp_path / "set", options).ok
    _, frames = read(version, tmp_path / "set", tmp_path)
    assert misplaced(frames) == 2 * len(frames) > 0


# --- robomimic ------------------------------------------------------------------------------------

LENGTH = 5


def sequences(folders: list[Path], tmp_path: Path) -> list[dict[str, Any]]:
    """Every sequence of an export, as the real robomimic gives it."""
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    out = tmp_path / "set"
    assert datasets.load("robomimic").write(folders, out, options).ok
    words = (out / "demos.hdf5", "train", LENGTH)
    versions, *found = run("0.4.4", "robomimic_reader.py", *words, home=tmp_path)
    assert versions["robomimic"] == "0.3.0"
    assert found.pop()["batch"] == [4, LENGTH, 64, 96, 3]
    return found


def wrong_in(sequence: dict[str, Any], key: str, later: int) -> int:
    """Pictures of a sequence that are not those of their time, or of ``later`` frames on.

    The sequence is filled up with its recording's last frame, and so is ``next_obs``.
    """
    wrong = 0
    grid = sequence["grid_ns"]
    recording = sequence["obs"][0][0][0] if sequence["obs"][0][0] else None
    for camera, shown in enumerate(sequence[key]):
        for place, picture in enumerate(shown):
            last = sequence["dones"][place]
            frame = grid[place] // FRAME_NS + (0 if last else later)
            wrong += picture != [recording, camera, frame]
    return wrong


def test_robomimic_gives_every_frame_right(recordings: list[Path], tmp_path: Path) -> None:
    found = sequences(recordings, tmp_path)
    what = Synthetic()
    pictures = 0
    for sequence in found:
        recording = sequence["obs"][0][0][0]
        what.seconds = 1.0 + 0.35 * recording
        assert recording in IDENTITIES
        assert wrong_in(sequence, "obs", 0) == wrong_in(sequence, "next", 1) == 0
        steps = [b - a for a, b in zip(sequence["grid_ns"], sequence["grid_ns"][1:], strict=False)]
        assert all(
            step == FRAME_NS or done for step, done in zip(steps, sequence["dones"], strict=False)
        )
        for grid_ns, state in zip(sequence["grid_ns"], sequence["state"], strict=True):
            assert state[:3] == pytest.approx(list(what.executed(grid_ns * 1e-9)), abs=1e-7)
        for grid_ns, force in zip(sequence["grid_ns"], sequence["force"], strict=True):
            assert force == pytest.approx(felt_forces.expected(grid_ns), abs=1e-6)
        pictures += 4 * LENGTH
    grids = {(s["obs"][0][0][0], s["grid_ns"][0]) for s in found}
    assert len(grids) == len(found), "every frame begins one sequence"
    told = f"sequences of {LENGTH} frames with the next ones, {pictures} pictures, 0 misplaced"
    told += "; forces right"
    note("reader robomimic 0.3.0", len(found), told)


def test_robomimic_sees_that_pictures_are_late(recordings: list[Path], tmp_path: Path) -> None:
    late = []
    for number, folder in enumerate(recordings):
        late.append(datasets_synthetic.copy(folder, tmp_path / f"late{number}", note="late"))
        datasets_synthetic.shift_pictures(late[-1], FRAME_NS)
    found = sequences(late, tmp_path)
    wrong = sum(wrong_in(sequence, "obs", 0) for sequence in found)
    assert wrong == 2 * LENGTH * len(found) > 0
