"""What the command line makes of statuses: a missing or invalid one is never good news."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rospy")

from helpers.graph.statuses import heard_by_watch, record_status, sim_status, stamped
from surg_cli.graph import follow
from surg_cli.graph.episode_process import progress
from surg_cli.graph.task_episode import policy_record
from surg_msgs import msg


def watch(record: Any = None, sim: Any = None) -> Any:
    """A watch that has heard these statuses, without ROS."""
    heard = {"/record/status": record, "/sim/status": sim}
    return heard_by_watch(heard, record=lambda on: None)


@pytest.fixture
def supervisor(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(follow, "STATUS_TIMEOUT_S", 0.01)
    child = SimpleNamespace(name="/recorder", exit_code=None)
    return SimpleNamespace(children=[child], first_dead=lambda: None)


def test_a_recording_is_complete_only_if_the_recorder_states_it(supervisor: Any) -> None:
    assert follow.finish_recording(watch(record_status("IDLE")), supervisor) == []


@pytest.mark.parametrize(
    "status",
    [
        None,
        msg.RecordStatus(),
        record_status("RECORDING"),
        record_status("FINISHING"),
        stamped(msg.RecordStatus(state=99, problem=msg.RecordStatus.PROBLEM_NONE)),
        stamped(msg.RecordStatus(state=msg.RecordStatus.STATE_IDLE)),
        stamped(
            msg.RecordStatus(
                state=msg.RecordStatus.STATE_IDLE, problem=msg.RecordStatus.PROBLEM_INCOMPLETE
            )
        ),
    ],
    ids=["none", "default", "recording", "finishing", "unknown", "no problem code", "incomplete"],
)
def test_no_other_status_is_a_complete_recording(status: Any, supervisor: Any) -> None:
    assert len(follow.finish_recording(watch(status), supervisor)) == 1


def test_an_invalid_simulator_status_neither_ends_nor_keeps_a_run(supervisor: Any) -> None:
    done = sim_status("DONE")
    assert follow.failure(watch(sim=done), supervisor) == []
    done.version = 9
    heard = watch(sim=done)
    assert heard.sim.state == 0
    (problem,) = follow.failure(heard, supervisor)
    assert "version is 9" in problem, "its ticks do not count: the run ends by the stall"


def test_the_record_of_a_policy_keeps_the_keys_of_the_result_files() -> None:
    status = msg.PolicyStatus(
        state=msg.PolicyStatus.STATE_IDLE,
        rejected_rules=["step"],
        rejected_by_rule=[3],
        obs_age_p50=0.08,
        obs_age_p99=0.2,
        round_trip_p50=float("nan"),
    )
    kept = policy_record(status)
    assert (kept["state"], kept["session"]) == ("IDLE", None)
    assert kept["rejected_by_rule"] == {"step": 3} and kept["malformed"] == {}
    assert kept["obs_age_ms"] == {"p50": 80.0, "p99": 200.0}
    assert kept["round_trip_ms"] == {"p50": None, "p99": None}


def test_a_line_that_is_still_being_written_is_no_news() -> None:
    line = '{"seconds": 0.25, "note": "waiting for a policy at tcp://127.0.0.1:5555"}'
    assert progress(line) == (0.25, "waiting for a policy at tcp://127.0.0.1:5555")
    for end in range(len(line)):
        assert progress(line[:end]) is None
    assert progress("Traceback (most recent call last):") is None
    assert progress("7") is None
