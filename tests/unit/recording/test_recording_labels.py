"""Labels given after the recording, and expressions that select episodes."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from helpers.recording import datasets_synthetic
from helpers.recording.recording_synthetic import TICK_NS
from surg_console.labelling.label_pages import LabelPages
from surg_recording import datasets
from surg_recording.clock import sync_report
from surg_recording.datasets import ExportError, ExportOptions
from surg_recording.episode import episode_reader, labels, selection
from surg_recording.episode.selection import Selection, SelectionError
from surg_recording.episode.verdicts import verdict
from surg_recording.recording_errors import EpisodeError
from surg_recording.reports import evaluation

SERIAL = ExportOptions(executor="serial")
CUT = (130 * TICK_NS, 330 * TICK_NS)
GIVEN = {
    "success": False,
    "note": "slipped",
    "stages": [
        {"name": "follow", "begin_ns": str(150 * TICK_NS), "end_ns": str(200 * TICK_NS)},
        {"name": "mine", "begin_ns": str(200 * TICK_NS), "end_ns": None},
    ],
    "trim": {"begin_ns": str(CUT[0]), "end_ns": str(CUT[1])},
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return datasets_synthetic.record(tmp_path_factory.mktemp("labels") / "e", 1, 0.7)


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / "e"))


def hashes_below(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def label(folder: Path, stated: Any = None) -> dict[str, Any]:
    return LabelPages([folder], "A").save(1, GIVEN if stated is None else stated)


def test_labels_are_applied_and_nothing_that_was_recorded_changes(folder: Path) -> None:
    before = hashes_below(folder)
    label(folder)
    after = hashes_below(folder)
    assert after.pop(labels.LABELS) and after == before
    found = episode_reader.read(folder)
    judged = verdict(found.manifest)
    assert (judged.success, judged.reason, judged.by) == (False, "slipped", "person")
    assert judged.disagreement is not None and "task" in judged.disagreement
    first, second = found.stages
    assert first["text"] == datasets_synthetic.STAGES["follow"] and first["by"] == "A"
    assert second == {"name": "mine", "begin_ns": 200 * TICK_NS, "end_ns": None, "by": "A"}
    # What writes into the manifest leaves the labels where they are.
    sync_report.write(folder)
    stated = json.loads((folder / "manifest.json").read_text())
    assert "labels" not in stated and "sync" in stated
    assert [stage["name"] for stage in stated["stages"]] == ["wait", "reach", "follow"]


def test_an_export_and_an_evaluation_use_the_trimmed_time(folder: Path, tmp_path: Path) -> None:
    whole = evaluation.measure(episode_reader.read(folder))["duration_s"]
    label(folder)
    measured = evaluation.measure(episode_reader.read(folder))
    assert whole == pytest.approx(0.698, abs=0.003)
    assert measured["duration_s"] == pytest.approx((CUT[1] - CUT[0]) * 1e-9, abs=0.003)
    options = dataclasses.replace(SERIAL, keep_parts=True)
    assert datasets.load("act").write([folder], tmp_path / "out", options).ok
    with h5py.File(tmp_path / "out/episode_0.hdf5") as root:
        grid = _grid(root)
        assert grid.min() >= CUT[0] and grid.max() <= CUT[1] and len(grid) >= 2
    stated = json.loads((tmp_path / "out/surg_export.json").read_text())
    assert stated["recordings"][0]["kind"] == "failure"
    label(folder, {"success": True})
    replaced = dataclasses.replace(options, replace=True)
    assert datasets.load("act").write([folder], tmp_path / "out", replaced).made == 1


def _grid(root: Any) -> Any:
    found: list[Any] = []
    root.visititems(lambda name, item: found.append(item) if name.endswith("grid_ns") else None)
    return np.asarray(found[0][()])


@pytest.mark.parametrize(
    ("stated", "named"),
    [
        ([], "object"),
        ({"success": "yes"}, "success"),
        ({"note": "x" * 4001}, "note"),
        ({"stages": [{"name": "a"}]}, "stages[0]"),
        ({"stages": [{"name": "", "begin_ns": 1, "end_ns": 2}]}, "stages[0]"),
        ({"stages": [{"name": "a", "begin_ns": 5, "end_ns": 2}]}, "stages[0]"),
        ({"stages": [{"name": "a", "begin_ns": -5, "end_ns": 2}]}, "begin_ns"),
        ({"stages": [{"name": "a", "begin_ns": 2**63, "end_ns": None}]}, "begin_ns"),
        ({"trim": {"begin_ns": 2, "end_ns": 1}}, "trim"),
        ({"trim": {"begin_ns": 1.5, "end_ns": None}}, "begin_ns"),
        ({"hidden": 1}, "hidden"),
    ],
)
def test_wrong_labels_are_refused_by_their_key(folder: Path, stated: Any, named: str) -> None:
    with pytest.raises(ValueError, match=named.replace("[", r"\[")):
        label(folder, stated)
    assert not (folder / labels.LABELS).exists()


@pytest.mark.parametrize(
    "content", ["{", '{"format": "other"}', '{"format": "surg_labels/1", "success": 3}']
)
def test_a_broken_side_file_is_one_error_that_names_it(folder: Path, content: str) -> None:
    (folder / labels.LABELS).write_text(content)
    with pytest.raises(EpisodeError, match=labels.LABELS):
        episode_reader.read(folder)


# --- selection ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "fits"),
    [
        ('success and setting == "phantom"', True),
        ("not success", False),
        ("seed in [1, 2] and duration > 0.5", True),
        ('"reach" in stages and "PSM1" in arms', True),
        ("law is None and law < 3", False),
        ("judged_by == 'task' or labelled", True),
        ("0.5 < duration < 2", True),
        ("seed == -1", False),
        ("'x' in note", False),
    ],
)
def test_an_expression_selects_by_facts(recorded: Path, text: str, fits: bool) -> None:
    assert Selection(text).matches(episode_reader.read(recorded)) is fits


@pytest.mark.parametrize(
    "text",
    [
        "",
        "success and",
        "__import__('os').system('true')",
        "().__class__",
        "[x for x in tags]",
        "lambda: 1",
        "colour == 3",
        "seed + 1 == 2",
        "tags[0] == 'a'",
        "f'{seed}'",
        "b'x' == note",
        "seed := 3",
        "(" * 500 + "1" + ")" * 500,
        " or ".join(["success"] * 300),
        "x" * 1001,
    ],
)
def test_what_is_no_plain_comparison_is_refused_before_an_episode_is_read(text: str) -> None:
    with pytest.raises(SelectionError):
        Selection(text)


def test_a_senseless_comparison_is_named(recorded: Path) -> None:
    with pytest.raises(SelectionError, match="task > 3"):
        Selection("task > 3").matches(episode_reader.read(recorded))


def test_facts_have_the_names_that_are_documented(recorded: Path) -> None:
    assert set(selection.facts(episode_reader.read(recorded))) == set(selection.FACTS)


def test_an_export_takes_what_fits_and_splits_by_the_recording_alone(
    recorded: Path, tmp_path: Path
) -> None:
    folders = []
    for number in range(6):
        target = tmp_path / f"e{number}"
        folders.append(datasets_synthetic.copy(recorded, target, seed=number))
    label(folders[0], {"success": False})
    options = dataclasses.replace(
        SERIAL, keep_parts=True, split_by="hash", splits={"train": 0.5, "val": 0.5}
    )

    def splits(name: str, chosen: list[Path], where: str | None) -> dict[str, str]:
        asked = dataclasses.replace(options, where=where)
        assert datasets.load("act").write(chosen, tmp_path / name, asked).ok
        stated = json.loads((tmp_path / name / "surg_export.json").read_text())
        found = {}
        for split, (begin, end) in stated["splits"].items():
            found |= {Path(r["source"]).name: split for r in stated["recordings"][begin:end]}
        return found

    every = splits("every", folders, None)
    assert every["e0"] == "failure" and len(every) == 6
    assert {"train", "val"} <= set(every.values())
    some = splits("some", folders[::-1], "success and seed != 3")
    assert set(some) == {"e1", "e2", "e4", "e5"}
    assert some == {name: every[name] for name in some}
    with pytest.raises(ExportError, match="none of 6"):
        splits("none", folders, "seed == 77")
    with pytest.raises(ValueError, match="where"):
        dataclasses.replace(options, where="seed ==")


def test_an_evaluation_takes_what_fits(recorded: Path, tmp_path: Path) -> None:
    other = datasets_synthetic.copy(recorded, tmp_path / "other", seed=2)
    folders = [recorded, other]
    chosen = Selection("seed == 2")
    entries, left_out = evaluation.measure_all(folders, None, False, lambda *_: None, chosen)
    assert [entry["folder"] for entry in entries] == [str(other)] and not left_out
