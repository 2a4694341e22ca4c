"""What the page says of the phantom's task."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from surg_console.session.system_state import Follower, Robot, SimTask
from surg_console.session.task_view import TaskView

WORDS = {"instruction": "Retract it.", "stages": {"grasp": "Grasp it.", "still": "Hold it."}}
FOLLOWS = Follower("FOLLOWING")


def test_the_phase_is_told_in_words_and_what_comes_next() -> None:
    view, task = TaskView(json.dumps(WORDS)), SimTask("RUNNING", "bgr", "grasp")
    told = view.report(Robot(task=task), 0.0)
    assert told is not None
    assert (told["sentence"], told["now"], told["next"]) == ("Retract it.", "Grasp it.", "Hold it.")
    told = view.report(Robot(task=replace(task, phase="still")), 0.0)
    assert told is not None and (told["now"], told["next"], told["ended"]) == ("Hold it.", "", "")
    assert view.report(Robot(), 0.0) is None
    assert view.report(Robot(task=SimTask("NONE")), 0.0) is None


def test_a_task_without_a_sentence_is_shown_by_its_name() -> None:
    told = TaskView().report(Robot(task=SimTask("RUNNING", "mine", "begin")), 0.0)
    assert told is not None and (told["sentence"], told["now"]) == ("mine", "begin")


def test_time_runs_from_the_first_motion_to_the_end_of_each_episode() -> None:
    view, task = TaskView(), SimTask("RUNNING", "bgr", "grasp")

    def ended(now: float, task: SimTask, follower: Follower = FOLLOWS) -> str:
        told = view.report(Robot(follower=follower, task=task), now)
        assert told is not None
        return str(told["ended"])

    assert ended(5.0, task, Follower("WAITING")) == ""
    assert ended(10.0, task) == ended(30.0, task) == ""
    done = replace(task, state="SUCCESS")
    assert ended(44.5, done) == ended(99.0, done) == "Success after 34.5 s"
    again = replace(task, seed=1)
    assert ended(100.0, again) == ended(101.0, again) == ""
    assert ended(102.0, replace(again, state="FAILURE", detail="lost")) == (
        "Failure after 2.0 s: lost"
    )


@pytest.mark.parametrize("wrong", ["{", "[]", '{"stages": 1}'])
def test_words_that_are_none_are_refused(wrong: str) -> None:
    with pytest.raises(ValueError, match=r"instruction|Expecting"):
        TaskView(wrong)
