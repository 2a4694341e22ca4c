"""Every numbered example runs, and the pages that list them are complete."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from helpers.examples.course import EXAMPLES, ROS_STEP, STEPS, play
from surg_cli.host import paths

FIRST_OF_THE_CHAIN = 5
"""Steps from here on read what the one before wrote."""
ALONE = [step for step in STEPS if int(step.name[:2]) < FIRST_OF_THE_CHAIN]
CHAIN = [step for step in STEPS if step not in (*ALONE, ROS_STEP)]


def figure(pattern: str, text: str) -> float:
    """The number that a line of the output states."""
    found = re.search(pattern, text)
    assert found, f"no {pattern!r} in: {text}"
    return float(found[1])


@pytest.mark.parametrize("step", ALONE, ids=lambda step: step.stem)
def test_a_step_runs_by_itself_and_keeps_the_pivot(step: Path, tmp_path: Path) -> None:
    said = play(step, tmp_path)
    micrometres = re.search(r"RCM deviation (?:at most )?([\d.]+) (um|mm)", said)
    assert micrometres, said
    assert float(micrometres[1]) * (1000.0 if micrometres[2] == "mm" else 1.0) < 50.0
    assert "False" not in said and "time limit" not in said
    assert list(tmp_path.iterdir()) == []


def test_the_chain_records_evaluates_exports_and_trains(tmp_path: Path) -> None:
    said = {step.stem: play(step, tmp_path) for step in CHAIN}
    assert figure(r"^(\d+) episodes recorded", said["05_recording"]) == 20
    assert figure(r"success (\d+) of 20", said["06_evaluation"]) == 20
    assert figure(r"^(\d+) episodes", said["07_export"]) == 20
    assert figure(r"validation error ([\d.]+) mm", said["08_training"]) < 0.5
    assert np.load(tmp_path / "runs/course/weights.npz")["W"].shape == (7, 3)


@pytest.mark.parametrize("step", [step for step in CHAIN if step != CHAIN[0]], ids=lambda s: s.stem)
def test_a_step_of_the_chain_names_the_step_that_it_needs(step: Path, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match=r"run examples/0\d_\w+\.py first"):
        play(step, tmp_path)


def test_the_code_on_the_first_page_runs_as_printed(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (paths.ROOT / "README.md").read_text(), re.DOTALL)
    (tmp_path / "readme.py").write_text(code)
    said = play(tmp_path / "readme.py", paths.ROOT)
    assert figure(r"RCM deviation ([\d.]+) um", said) < 5.0
    assert 115.0 < figure(r"depth ([\d.]+) mm", said) < 125.0


def test_the_course_is_numbered_without_gaps_and_listed() -> None:
    assert [int(step.name[:2]) for step in STEPS] == list(range(1, len(STEPS) + 1))
    page = (EXAMPLES / "README.md").read_text("utf-8")
    assert re.findall(r"\]\((\d\d_\w+\.py)\)", page) == [step.name for step in STEPS]
    for step in STEPS:
        assert f"examples/{step.name}" in step.read_text("utf-8").split('"""')[1], step.name
