"""Stages of long work: done once, taken up where they ended, and a broken one is said."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from surg_learn.learn_terminal import LearnError
from surg_learn.stage_ledger import Ledger


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
