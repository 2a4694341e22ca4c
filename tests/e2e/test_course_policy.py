"""The last step of the course: its policy drives the arm through the ROS graph."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from helpers.examples.course import EXAMPLES, ROS_STEP, play
from helpers.graph.surg import surg

# The chain before it is in tests/unit/examples, a policy through the graph in test_policy_run.py.
pytestmark = [pytest.mark.ros, pytest.mark.untimed, pytest.mark.full]


def test_the_policy_of_the_course_solves_its_task_through_the_model_server(tmp_path: Path) -> None:
    for name in ("05_recording.py", "07_export.py", "08_training.py"):
        play(EXAMPLES / name, tmp_path)
    out = tmp_path / "run"
    words = ("--policy", ROS_STEP, "--observe", "privileged", "--seed", 20_000, "--out", out)
    weights = str(tmp_path / "runs/course/weights.npz")
    done = surg("run", EXAMPLES / "04_task.py", *words, extra={"SURG_COURSE_WEIGHTS": weights})
    assert done.returncode == 0, done.stdout + done.stderr
    (entry,) = json.loads((out / "summary.json").read_text("utf-8"))["episodes"]
    assert entry["success"] and entry["policy"]["policy"] == "TouchPolicy"
    assert entry["policy"]["accepted"] > 0
    assert [entry["policy"][name] for name in ("rejected", "clipped", "late")] == [0, 0, 0]
