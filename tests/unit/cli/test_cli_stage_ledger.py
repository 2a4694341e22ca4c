"""Stages of long work: done once, taken up where they ended, and a broken one is said."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from surg_learn.learn_terminal import LearnError
from surg_learn.stage_ledger import Ledger


class Work:
    """Three stages that count how often they are done; one can be broken."""

    def __init__(self) -> None:
        self.done: list[str] = []
        self.broken: str | None = None

    def run(self, file: Path, seed: int = 0) -> list[str]:
        ledger = Ledger(file, "./surg learn bgr --out X")

        def do(name: str) -> str:
            if self.broken == name:
                raise LearnError(f"{name} has no disk", 1)
            self.done.append(name)
            return f"{name} of {seed}"

        return [
            ledger.stage("show", {"n": 8}, lambda: do("show")),
            ledger.stage("train", {"seed": seed}, lambda: do("train")),
            ledger.stage("deploy", {}, lambda: do("deploy")),
        ]


def test_what_is_done_is_not_done_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    work, file = Work(), tmp_path / "stages.json"
    first = work.run(file)
    assert work.done == ["show", "train", "deploy"]
    assert work.run(file) == first and len(work.done) == 3
    assert capsys.readouterr().out.count("already done") == 3


def test_a_changed_stage_and_all_behind_it_are_done_anew(tmp_path: Path) -> None:
    work, file = Work(), tmp_path / "stages.json"
    work.run(file)
    assert work.run(file, seed=1)[1] == "train of 1"
    assert work.done[3:] == ["train", "deploy"]


def test_a_broken_stage_is_said_and_taken_up(tmp_path: Path) -> None:
    work, file = Work(), tmp_path / "stages.json"
    work.broken = "train"
    with pytest.raises(LearnError) as said:
        work.run(file)
    text = str(said.value)
    assert "stage 'train'" in text and "no disk" in text and "./surg learn bgr --out X" in text
    work.broken = None
    work.run(file)
    assert work.done == ["show", "train", "deploy"]  # show was not done again


def test_time_of_attempts_that_were_cut_off_counts(tmp_path: Path) -> None:
    file = tmp_path / "stages.json"

    def cut_off() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Ledger(file, "").stage("show", 1, cut_off)
    kept = json.loads(file.read_text())
    assert kept["stages"]["show"]["done"] is False
    kept["stages"]["show"]["s"] = 100.0
    file.write_text(json.dumps(kept))
    ledger = Ledger(file, "")
    ledger.stage("show", 1, lambda: "done")
    assert 100.0 <= ledger.seconds["show"] < 110.0


@pytest.mark.parametrize("content", ["", "[]", '{"format": "surg_stages/9", "stages": {}}'])
def test_a_ledger_that_is_none_is_refused(tmp_path: Path, content: str) -> None:
    file = tmp_path / "stages.json"
    file.write_text(content)
    with pytest.raises(LearnError, match=r"stages\.json"):
        Ledger(file, "")
