"""What a learned policy came to: the summary's numbers from entries whose values are known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from helpers.recording.rollouts_synthetic import entry, rollout
from surg_recording.reports import learning, learning_report

INFO: dict[str, Any] = {
    "title": "Bowel grasping and retraction",
    "task": "bgr",
    "setting": "phantom",
    "robot": "ur5e",
    "demonstrations": 8,
    "demonstrations_success": 7,
    "observation": ["observation.state", "privileged.task_state"],
    "privileged": ["privileged.task_state"],
    "policy": "chunks of 16",
    "stages_s": {"demonstrations": 10.0, "training": 5.0},
}


def summary(rollouts: list[dict[str, Any]], least: int = 17) -> dict[str, Any]:
    return learning.summarise(rollouts, [entry(1, sparc=-2.0)], INFO, least)


def test_seventeen_of_twenty_are_enough_and_sixteen_are_not() -> None:
    for good, ok in ((17, True), (16, False)):
        found = summary([rollout(seed, success=seed < good) for seed in range(20)])
        assert found["ok"] is ok and found["success_rate"]["k"] == good
    assert "16 of 20" in found["reasons"][0] and "17" in found["reasons"][0]


def test_numbers_are_those_of_the_rollouts() -> None:
    found = summary([rollout(s, rcm=0.01 * (s + 1), sparc=-3.0 - s) for s in range(3)], 3)
    assert found["ok"] and found["unsafe_commands"] == 0 and found["unsafe"]["cycles"] == 18_000
    assert found["rcm_max_mm"] == pytest.approx({"n": 3, "min": 0.01, "median": 0.02, "max": 0.03})
    smooth = found["smoothness"]["sparc"]
    assert smooth["rollouts"]["median"] == -4.0 and smooth["demonstrations"]["median"] == -2.0
    assert (found["rejected"], found["clipped"], found["late"]) == (3, 6, 0)
    assert found["obs_age_ms"] == {"p50": 50.0, "p99": 100.0}
    assert found["rollouts"][1]["rcm_max_mm"] == 0.02


def test_an_unsafe_command_fails_whatever_succeeded() -> None:
    found = summary([rollout(0), rollout(1, unsafe=3)], 2)
    assert not found["ok"] and found["unsafe_commands"] == 3
    assert found["unsafe"]["rules"] == {"joint velocity": 3}


def test_a_rollout_without_a_recording_is_not_called_safe() -> None:
    found = summary([rollout(0), rollout(1, unsafe=None)], 2)
    assert not found["ok"] and "1 roll-outs have no recording" in found["reasons"][0]


def test_what_the_server_did_not_say_is_not_made_up(tmp_path: Path) -> None:
    found = summary([rollout(0, served={})], 1)
    assert found["ok"] and found["late"] is None
    assert found["round_trip_ms"] == {"p50": None, "p99": None}


def test_the_report_says_what_is_privileged_and_every_cause(tmp_path: Path) -> None:
    rollouts = [rollout(0), rollout(1, success=False)]
    found = summary(rollouts, 2)
    learning_report.write(found, [entry(0), entry(1, False)], [entry(5)], tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    for words in ("privileged.task_state", "no robot can measure", "the robot lost its grasp"):
        assert words in page
    kept = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert kept["rollouts"][1]["reason"] == "the robot lost its grasp"
    assert sorted(p.name for p in (tmp_path / "figures").iterdir()) == [
        "rcm_deviation.png",
        "smoothness.png",
    ]


@pytest.mark.parametrize("outcomes", ["sfsf", "ss", "ff", "usf"])
def test_the_report_shows_the_first_failure_and_the_first_success(
    outcomes: str, tmp_path: Path
) -> None:
    """Or says that there was none; s: success, f: failure, u: was not played."""
    rollouts = [
        {**rollout(70 + n, success=kind == "s"), "played": kind != "u"}
        for n, kind in enumerate(outcomes)
    ]
    shown = [entry(n, kind == "s") for n, kind in enumerate(outcomes)]
    for wanted, name in learning_report.FILMS.items():
        if ("s" if wanted else "f") in outcomes:
            (tmp_path / name).write_bytes(b"film of " + name.encode())
    found = summary(rollouts, 1)
    learning_report.write(found, shown, [entry(5)], tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    for kind, word in (("f", "failed"), ("s", "successful")):
        if kind in outcomes:
            assert f"The first {word} roll-out, seed {70 + outcomes.index(kind)}" in page
        else:
            assert f"The first {word}" not in page
    assert ("No roll-out failed" in page) is ("f" not in outcomes)
    assert ("No roll-out succeeded" in page) is ("s" not in outcomes)
    assert page.count("data:video/mp4") == len(set(outcomes) - {"u"})
    # A film that could not be made is named as missing.
    for name in learning_report.FILMS.values():
        (tmp_path / name).unlink(missing_ok=True)
    learning_report.write(found, shown, [entry(5)], tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert page.count("There is no film") == len(set(outcomes) - {"u"})
