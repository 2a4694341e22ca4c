"""`./surg episode evaluate`: what it finds, says, refuses and writes."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import pytest

from helpers.graph.surg import called
from helpers.recording import jigsaws_synthetic
from helpers.recording.evaluated import DONE, episode
from surg_cli.commands.episode import evaluate
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_recording import metrics
from surg_recording.metrics import reference_sets

run = functools.partial(called, "episode evaluate")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("runs")
    for seed, setting in ((1, "phantom"), (2, "phantom"), (3, "ex_vivo")):
        episode(root / str(seed) / "episode", seed, task=DONE, setting=setting)
    (root / "4").mkdir()
    (root / "4" / "manifest.json").write_text("{")
    return root


def test_what_help_tells_is_what_there_is() -> None:
    assert list(metrics.PRESETS) == list(evaluate.PRESETS)
    kinds = ", ".join(f"{kind}:{what}" for kind, (what, _) in reference_sets.KINDS.items())
    assert kinds == evaluate.REFERENCES


def test_runs_are_evaluated_without_a_word(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(paths, "RUNS", runs)
    folder = jigsaws_synthetic.write_task(tmp_path, {"B001": "E", "C001": "N"})
    words = ["--reference", f"jigsaws:{folder}", "--preset", "paper", "--out", tmp_path / "out"]
    assert run(*words) == 0
    said = capsys.readouterr()
    assert said.out.splitlines()[-1] == str(tmp_path / "out" / "summary.json")
    assert "phantom" in said.out and "JIGSAWS Knot Tying" in said.out and "preset paper" in said.out
    assert "left out:" in said.err and "not valid JSON" in said.err
    summary = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))
    assert {name: c["n"] for name, c in summary["conditions"].items()} == {
        "phantom": 2, "ex_vivo": 1,
    }  # fmt: skip
    assert summary["reference"]["trials"] == 2 and summary["preset"]["name"] == "paper"
    assert (tmp_path / "out" / "report.html").exists()


def test_a_selection_that_nothing_fits_writes_no_report(runs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(CliError, match="3 do not fit, 1 are left out") as problem:
        run(runs, "--where", 'setting == "in_vivo"', "--out", out)
    assert problem.value.code == 2
    assert not (out / "summary.json").exists()


def test_without_any_episode_it_says_how_to_make_some(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in (tmp_path, tmp_path / "runs"):
        monkeypatch.setattr(paths, "RUNS", place)
        with pytest.raises(CliError, match=r"\./surg run bgr"):
            run()


def test_a_reference_set_needs_no_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(paths, "RUNS", tmp_path / "runs")
    folder = jigsaws_synthetic.write_task(tmp_path, {"B001": "E", "B002": "E", "C001": "N"})
    assert run("--reference", f"jigsaws:{folder}", "--out", tmp_path / "out") == 0
    said = capsys.readouterr().out
    assert "JIGSAWS Knot Tying, expert" in said and "No episode" not in said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))
    assert summary["conditions"] == {} and summary["reference"]["by_skill"]["expert"]["trials"] == 2
    assert [file.name for file in sorted((tmp_path / "out" / "figures").iterdir())] == [
        "smoothness.png",
        "smoothness.svg",
    ]
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "No episode could be evaluated" not in page and "data:image/png" in page
    with pytest.raises(CliError, match="no such folder"):
        run(tmp_path / "runs", "--reference", f"jigsaws:{folder}")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["/nowhere"], "/nowhere: no such folder"),
        (["--preset", "mine"], "there are reference, paper"),
        (["--reference", "jigsaws"], "jigsaws:DIR or motion:CSV_OR_DIR is needed"),
        (["--reference", "jigsaws:/nowhere"], "/nowhere: no such folder"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_written(
    words: list[str],
    said: str,
    runs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(paths, "RUNS", runs)
    with pytest.raises(CliError) as caught:
        run(*words, "--out", tmp_path / "out")
    assert said in str(caught.value) and caught.value.code == 2
    assert not (tmp_path / "out").exists()


def test_episodes_that_cannot_be_used_end_with_1(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(runs / "4", "--out", tmp_path / "out") == 1
    assert "none of 1 episodes could be evaluated" in capsys.readouterr().err
    assert "No episode could be evaluated" in (tmp_path / "out" / "report.html").read_text("utf-8")
