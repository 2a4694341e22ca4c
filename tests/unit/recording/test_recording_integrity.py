"""Recordings that are not as they were recorded: noticed alike by export, evaluation and page."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from helpers.recording import datasets_synthetic
from helpers.recording.corruptions import ALL
from helpers.recording.evaluated import DONE, episode
from helpers.recording.recording_synthetic import Synthetic
from helpers.recording.restated import edit_field, restate, without_hashes
from surg_recording import datasets
from surg_recording.episode import episode_reader, integrity
from surg_recording.episode.verdicts import verdict
from surg_recording.file_io import file_hash
from surg_recording.reports import evaluation, evaluation_report, evaluation_tables

SERIAL = datasets.ExportOptions(executor="serial", drop=("privileged.ground_truth",))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording without a camera."""
    place = tmp_path_factory.mktemp("recorded") / "episode"
    return datasets_synthetic.record(place, 1, 1.0, (), task=False)


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copytree(recorded, tmp_path / "episode"))


def quiet(fraction: float | None, note: str) -> None:
    assert note


def measured(*folders: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Entries of an evaluation, and why the others were left out."""
    entries, left_out = evaluation.measure_all(folders, None, False, quiet)
    return entries, [each.reason for each in left_out]


def exported(*folders: Path) -> tuple[int, list[str], list[str]]:
    """Recordings that an export takes, refusals and warnings."""
    report = datasets.dry_run(datasets.load("robomimic"), folders, SERIAL, quiet)
    return report.recordings, list(report.refused.values()), report.warnings


SAID = {
    "half of the rows": "rows, the manifest says 600",
    "two rows swapped": "SHA-256",
    "a joint edited": "SHA-256",
    "a stamp of -2^63": "earlier than",
    "the first stamp is -2^63": "before 1970",
    "the last stamp is in 2262": "in the line before",
    "swapped, manifest fits": "is earlier than",
    "a NaN": "column p_tip_x: not a number",
    "a value of 1e308": "column q0: 1e+308 is too large",
}
"""Corruption of the cycles, and what is said of it."""


@pytest.mark.parametrize("name", SAID)
def test_evaluation_refuses_what_an_export_refuses(folder: Path, name: str) -> None:
    change = next(each.apply for each in ALL if each.name == f"cycles: {name}")
    other = Path(shutil.copytree(folder, folder.with_name("other")))
    edit_field(other / "command_PSM1.csv", 1, "source", "/another")
    restate(other)
    change(folder)
    entries, (reason,) = measured(folder, other)
    assert [entry["folder"] for entry in entries] == [str(other)]
    assert SAID[name] in reason and str(folder / "cycle_PSM1.csv") in reason
    count, (refusal,), _ = exported(folder, other)
    assert (count, refusal) == (1, reason), "one reading path for both"


def test_a_gap_is_not_bridged_by_a_straight_line(folder: Path) -> None:
    file = folder / "cycle_PSM1.csv"
    lines = file.read_text().splitlines(True)
    file.write_text("".join(lines[:200] + lines[240:]))
    restate(folder)
    _, (reason,) = measured(folder)
    assert "no control cycle for 82 ms" in reason


def test_the_page_says_what_was_edited(folder: Path) -> None:
    assert integrity.changes(episode_reader.read(folder)) == []
    edit_field(folder / "command_PSM1.csv", 5, "x", "0.5")
    (said,) = integrity.changes(episode_reader.read(folder))
    assert "command_PSM1.csv" in said and "SHA-256" in said


def test_every_file_has_its_hash_from_the_recording(tmp_path: Path) -> None:
    made = datasets_synthetic.record(tmp_path / "e", 1, 0.5, ("endoscope_left",))
    stated = integrity.files(made, episode_reader.read(made).manifest)
    data = {path for path in made.iterdir() if path.suffix in (".csv", ".mp4")}
    assert set(stated) == data and len(data) >= 6
    assert all(stated[path] == file_hash(path) for path in data)


def test_a_recording_without_hashes_is_read_and_said(folder: Path) -> None:
    without_hashes(folder)
    edit_field(folder / "cycle_PSM1.csv", 100, "q0", "1.234")
    (entry,), _ = measured(folder)
    assert "recorded without hashes" in entry["remarks"][0]
    count, _, (warning,) = exported(folder)
    assert count == 1 and "recorded without hashes" in warning


def test_every_metric_says_of_how_many_episodes_it_is(tmp_path: Path) -> None:
    """Three episodes, and one without the simulator's truth: its box holds two."""
    made = [
        episode(
            tmp_path / str(k),
            k,
            Synthetic(2.0, lag_s=k * 1e-3, truth=k != 2),
            task=DONE,
            setting="x",
        )
        for k in (1, 2, 3)
    ]
    entries, left_out = measured(*made)
    assert len(entries) == 3, left_out
    summary = evaluation.summarise(entries, [], "reference", None, {})
    found = summary["conditions"]["x"]
    counts = {metric.name: found[metric.name]["n"] for metric in evaluation.METRICS}
    assert counts["rcm_kinematic_max_mm"] == 3 and counts["rcm_true_max_mm"] == 2
    for text in (evaluation_tables.markdown(summary), evaluation_tables.latex(summary)):
        (row,) = (
            (line for line in text.splitlines() if "true RCM max" in line)
            if (text.startswith("|"))
            else (line for line in text.splitlines() if line.startswith("x "))
        )
        assert "n = 2" in row or ("$(2)$" in row and row.count("$(3)$") == 7)
    evaluation_report.write(summary, tmp_path / "out")
    assert "n = 2<" in (tmp_path / "out" / "report.html").read_text("utf-8")
    figure = (tmp_path / "out/figures/rcm_deviation.svg").read_text("utf-8")
    assert "n = 3" in figure and "n = 2" in figure  # a panel each
    assert "n = 3" in (tmp_path / "out/figures/smoothness.svg").read_text("utf-8")


# --- verdicts -----------------------------------------------------------------------------------

SOLVED = {"task": {"success": True, "done": True}}
FAILED = {"task": {"success": False, "done": True, "reason": "too late"}}
PERSON = {"success": False, "reason": "it tore", "by": "/surg_record"}


@pytest.mark.parametrize(
    ("manifest", "success", "by", "said"),
    [
        ({}, None, None, None),
        ({"sim": SOLVED}, True, "task", None),
        ({"sim": FAILED}, False, "task", None),
        ({"sim": {"task": {"success": True, "done": False}}}, None, None, None),
        ({"sim": SOLVED, "result": {"success": True, "by": "task"}}, True, "task", None),
        ({"result": PERSON}, False, "person", None),
        ({"result": {"success": True, "by": "/a"}}, True, "person", None),
        ({"sim": SOLVED, "result": PERSON}, False, "person",
         "by person: failure (it tore); by task: success"),
        ({"sim": FAILED, "result": {"success": True, "by": "/a"}}, True, "person",
         "by person: success; by task: failure (too late)"),
        ({"sim": SOLVED, "tags": [{"text": "failure"}]}, False, "person",
         "by person: failure (tag failure); by task: success"),
        ({"tags": ["failure"], "result": {"success": True, "by": "/a"}}, False, "person",
         "by person: failure (tag failure); by person: success"),
    ],
)  # fmt: skip
def test_a_persons_verdict_counts_first(
    manifest: dict[str, Any], success: bool | None, by: str | None, said: str | None
) -> None:
    found = verdict(manifest)
    assert (found.success, found.by, found.disagreement) == (success, by, said)


@pytest.mark.parametrize(
    ("manifest", "outcome", "reason"),
    [
        ({}, "not judged", ""),
        ({"sim": SOLVED}, "success", ""),
        ({"sim": FAILED}, "failure", "too late"),
        ({"sim": {"task": {"success": False, "done": False}}}, "aborted", "before the task was"),
        ({"sim": {"aborted": "no answer"}}, "aborted", "no answer"),
        ({"run": {"outcome": {"outcome": "crashed", "reason": "bad"}}}, "crashed", "bad"),
        ({"run": {"outcome": {"outcome": "failure", "reason": "FAULT"}}}, "failure", "FAULT"),
        ({"run": {"outcome": {"outcome": "crashed"}}, "result": PERSON}, "failure", "it tore"),
    ],
)
def test_every_outcome_has_one_word(manifest: dict[str, Any], outcome: str, reason: str) -> None:
    found = verdict(manifest)
    assert found.outcome == outcome and reason in found.reason


def test_what_the_operator_called_a_failure_is_a_success_nowhere(tmp_path: Path) -> None:
    made = datasets_synthetic.record(tmp_path / "e", 1, 1.0, ("endoscope_left",))
    datasets_synthetic.edit(made, result=PERSON)
    (entry,), _ = measured(made)
    assert entry["success"] is False and entry["failure_reason"] == "it tore"
    assert "by task: success" in entry["disagreement"]
    summary = evaluation.summarise([entry], [], "reference", None, {})
    assert summary["conditions"]["phantom"]["success_rate"]["k"] == 0
    evaluation_report.write(summary, tmp_path / "out")
    assert "verdicts disagree" in (tmp_path / "out" / "report.html").read_text("utf-8")
    candidate = datasets.pipeline.inspection.inspect(made, SERIAL)
    assert candidate.kind == "failure"
    sampled = datasets.sample(candidate, SERIAL)
    assert not sampled.columns["next.success"].any()
    datasets_synthetic.edit(made, result={"success": True, "by": "/a"})
    sampled = datasets.sample(datasets.pipeline.inspection.inspect(made, SERIAL), SERIAL)
    assert sampled.columns["next.success"][-1]
    count, _, warnings = exported(made)
    assert count == 1 and warnings == []


# --- duplicates ---------------------------------------------------------------------------------


def test_a_recording_counts_once(folder: Path) -> None:
    twin = Path(shutil.copytree(folder, folder.with_name("twin")))
    datasets_synthetic.edit(twin, seed=77, task="another name")
    entries, (reason,) = measured(folder, twin)
    assert len(entries) == 1 and f"{twin}: the same recording as {folder}" in reason
    count, refused, _ = exported(folder, twin)
    assert count == 1 and refused == [reason]
    manifest = json.loads((folder / "manifest.json").read_text())
    for place in (folder, twin):
        datasets_synthetic.edit(place, sim={**manifest["sim"], "state_hash": "ab" * 32})
    edit_field(twin / "command_PSM1.csv", 1, "source", "/another")
    restate(twin)
    _, (reason,) = measured(folder, twin)
    assert f"{twin}: the same simulation as {folder} (state hash abababababab)" in reason
    assert exported(folder, twin)[1] == [reason]
