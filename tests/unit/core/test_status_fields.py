"""Every field of every status is classified: who decides by it, or why nobody does.

Each decider is the product's own code. It says yes to a complete message. With a field removed (its
default value, which is what a missing field is) it says no if it decides by that field, and still
yes if it does not.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rospy")

from helpers.graph.statuses import complete, fields, heard_by_watch, newest, removed
from surg_cli.commands import record, up
from surg_cli.graph import follow, policy_program, system, system_plan, task_episode
from surg_console.ros.ros_system_node import RosSystem
from surg_console.session.console_orders import Policy
from surg_console.session.console_session import SETTLED, ConsoleSession
from surg_console.session.system_state import Arm, Robot
from surg_console.web import calibration_socket
from surg_core.status_check import values
from surg_msgs import msg
from surg_policy_bridge.nodes.server_io_node import ServerIO
from surg_policy_bridge.server import operator_first
from surg_policy_bridge.server.stop_reason import StopReason
from surg_recording.nodes.recorder_topics_node import RecorderTopics
from surg_teleop.follow.teleop_node import TeleopNode
from surg_teleop.playback.operator_node import OperatorNode

TIME = time.monotonic


class WaitsForeverError(Exception):
    """A decider that would wait for a better status."""


# --- TeleopStatus ----------------------------------------------------------------------------


def policy_gets_the_arm(status: Any) -> bool:
    now = TIME()
    refusal = operator_first.refusal(["PSM1"], newest("/teleop/status", status, now), now)
    return refusal == operator_first.MAY


def console_enables_the_policy(status: Any) -> bool:
    session = page_in_control()
    session._policy_requested = TIME() - SETTLED - 0.1
    session.tick(console_state(status), TIME())
    return Policy(True) in session.take_orders()


# --- PolicyStatus ----------------------------------------------------------------------------


def console_may_start_the_policy(status: Any) -> bool:
    return page_in_control().policy("page", console_state(status), TIME()) == ""


def stop_need_not_disable_the_policy(status: Any) -> bool:
    session = page_in_control()
    session.stop(console_state(status))
    return Policy(False) not in session.take_orders()


def run_starts_its_simulator(status: Any) -> bool:
    plan = SimpleNamespace(policy=system_plan.Policy("tcp://127.0.0.1:1", "", "", False))
    watch = heard_by_watch({"/policy/status": status})
    policy_program.connect(plan, waiting_supervisor(), watch, lambda *_: None)
    return True


# --- RecordStatus ----------------------------------------------------------------------------


def run_has_a_complete_recording(status: Any) -> bool:
    recorder = SimpleNamespace(name="/recorder", exit_code=None)
    watch = heard_by_watch({"/record/status": status}, recording=False, record=lambda on: None)
    return follow.finish_recording(watch, SimpleNamespace(children=[recorder])) == []


def record_stop_succeeds(status: Any) -> bool:
    return record._stop(recorder_after(status), options(outcome=None)) == 0


def record_start_succeeds(status: Any) -> bool:
    recorder = recorder_after(status)
    idle = complete("RecordStatus", {"state": RECORD.STATE_IDLE, "starts": 1})
    recorder._on_status(idle, "/record/status")
    return record._start(recorder, options(info=[])) == 0


# --- SimStatus -------------------------------------------------------------------------------


def episode_is_a_success(status: Any) -> bool:
    does = {"record": lambda on: None, "tell_recorder": lambda facts: None}
    watch = heard_by_watch({"/sim/status": status}, recording=True, **does)
    supervisor = SimpleNamespace(children=[], first_dead=lambda: None)
    plan = SimpleNamespace(policy=None)
    return task_episode._follow(plan, supervisor, watch).success


def demonstration_is_a_success(status: Any) -> bool:
    topics = RecorderTopics.__new__(RecorderTopics)
    topics._sim = newest("/sim/status", None)
    topics._state = SimpleNamespace(sim_outcome={}, event=lambda *_: None)
    status._connection_header = {}
    topics._on_sim_status(status)
    return bool((topics._state.sim_outcome.get("task") or {}).get("success"))


def operator_ends(status: Any) -> bool:
    operator = OperatorNode.__new__(OperatorNode)
    operator._sim, operator.finished = newest("/sim/status", None), threading.Event()
    operator._on_sim_status(status)
    return operator.finished.is_set()


def system_is_up(status: Any) -> bool:
    watch = heard_by_watch({"/sim/status": status}, _states={})
    plan = SimpleNamespace(arms=(), lockstep=False, simulates=True)
    progress = SimpleNamespace(update=lambda *_: None)
    up._await_arms(plan, watch, waiting_supervisor(), progress)
    return True


def console_may_put_an_arm_back(status: Any) -> bool:
    return page_in_control().guide_home("page", console_state(status)) == ""


# --- CalibrationStatus -----------------------------------------------------------------------


def console_may_ask_the_collector(status: Any) -> bool:
    return calibration_socket.refusal(console_state(status).calibration) == ""


# --- SenderStatus ----------------------------------------------------------------------------


def sender_has_given_up(status: Any) -> bool:
    return "expert" in heard_by_watch({"/expert/status": status}).gave_up


# --- DriftStatus -----------------------------------------------------------------------------


def hand_is_refused(status: Any) -> bool:
    teleop = TeleopNode.__new__(TeleopNode)
    teleop.__dict__.update(_lock=threading.Lock(), _moved="")
    teleop._on_drift(status)
    return bool(teleop._moved)


def policy_is_refused(status: Any) -> bool:
    server = ServerIO.__new__(ServerIO)
    server.__dict__.update(lock=threading.Lock(), _moved="", rouse=lambda: None)
    server.on_drift(status)
    refused = operator_first.refusal([], newest("/", None), TIME(), False, moved=server._moved)
    return refused[0] is StopReason.CAMERA_MOVED


def manifest_says_it(status: Any) -> bool:
    topics = RecorderTopics.__new__(RecorderTopics)
    topics._drift = (status.state, status.cause)
    topics._state = SimpleNamespace(drift={})
    topics._on_drift(status)
    return bool(topics._state.drift)


# --- what the deciders need --------------------------------------------------------------------


def page_in_control() -> ConsoleSession:
    session = ConsoleSession(pictures=False)
    session.join("page", TIME())
    return session


def console_state(status: Any) -> Robot:
    """What the console makes of one status: an arm in FAULT, and nothing else heard."""
    topics = {
        "TeleopStatus": "/teleop/status",
        "PolicyStatus": "/policy/status",
        "RecordStatus": "/record/status",
        "SimStatus": "/sim/status",
        "CalibrationStatus": "/calibrate/status",
        "DriftStatus": "/endoscope/drift",
    }
    made = RosSystem.__new__(RosSystem)
    heard = {topic: newest(topic, None) for topic in topics.values()}
    heard[topics[type(status).__name__]].take(status, TIME())
    made.__dict__.update(
        _lock=threading.Lock(),
        _arms={"PSM1": Arm("PSM1", "FAULT")},
        _statuses=heard,
        _teleop="/teleop/status",
        _newest={},
        _peak=0.0,
        _fast={},
        _cycles={},
        _regions=(),
    )
    return made.robot()


def waiting_supervisor() -> Any:
    def wait() -> None:
        raise WaitsForeverError

    return SimpleNamespace(first_dead=wait, env={"ROS_MASTER_URI": ""}, logs=Path())


def recorder_after(status: Any) -> record.Recorder:
    """A recorder that answers every switch with this status."""
    made = record.Recorder.__new__(record.Recorder)
    made.__dict__.update(heard_by_watch({}).__dict__)
    made.record = lambda on: made._on_status(status, "/record/status")  # type: ignore[method-assign]
    return made


def options(**given: Any) -> Any:
    return SimpleNamespace(**given)


@pytest.fixture(autouse=True)
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name in (
        (follow, "STATUS_TIMEOUT_S"),
        (record, "START_S"),
        (record, "STOP_S"),
    ):
        monkeypatch.setattr(module, name, 0.01)
    monkeypatch.setattr(system, "start", lambda *_: None)
    monkeypatch.setattr(system, "model_server", lambda *_: None)
    monkeypatch.setattr(up.master, "call", lambda *_: True)


def says_yes(decider: Decider, status: Any, monkeypatch: pytest.MonkeyPatch) -> bool:
    if decider.call is episode_is_a_success:
        monkeypatch.setattr(follow, "finish_recording", lambda *_: [])
    try:
        return decider.call(status)
    except (record.CliError, WaitsForeverError):
        return False


# --- the classification --------------------------------------------------------------------------


@dataclass(frozen=True)
class Decider:
    """Who decides by a status.

    Attributes:
        call: Whether it says yes to a status.
        fields: By which it decides, beside version and stamp.
        given: Fields of the status to which it says yes.
    """

    call: Callable[[Any], bool]
    fields: tuple[str, ...]
    given: dict[str, Any]


POLICY, RECORD, SIM = msg.PolicyStatus, msg.RecordStatus, msg.SimStatus
SUCCESS = {"state": SIM.STATE_DONE, "task.state": msg.TaskStatus.STATE_SUCCESS}
DECIDERS: dict[str, list[Decider]] = {
    "TeleopStatus": [
        Decider(policy_gets_the_arm, ("hands", "hands.leader", "hands.arm", "hands.state"), {}),
        Decider(console_enables_the_policy, ("hands", "hands.state"), {}),
    ],
    "PolicyStatus": [
        Decider(console_may_start_the_policy, ("state",), {}),
        Decider(stop_need_not_disable_the_policy, ("state",), {}),
        Decider(run_starts_its_simulator, ("waiting",), {}),
    ],
    "RecordStatus": [
        Decider(run_has_a_complete_recording, ("state", "problem"), {}),
        Decider(record_stop_succeeds, ("state", "problem"), {}),
        Decider(record_start_succeeds, ("state", "starts"), {"state": RECORD.STATE_RECORDING}),
    ],
    "SimStatus": [
        Decider(episode_is_a_success, ("state", "task", "task.state"), SUCCESS),
        Decider(demonstration_is_a_success, ("task", "task.state"), SUCCESS),
        Decider(operator_ends, ("state",), {"state": SIM.STATE_DONE}),
        Decider(system_is_up, ("tick",), {}),
        Decider(console_may_put_an_arm_back, (), {}),
    ],
    "CalibrationStatus": [
        Decider(console_may_ask_the_collector, ("state", "step"), {}),
    ],
    # A watch that says nothing refuses nothing: it is no part of what keeps an arm safe.
    "DriftStatus": [
        Decider(hand_is_refused, ("state", "refusal"), {}),
        Decider(policy_is_refused, ("state", "refusal"), {}),
        Decider(manifest_says_it, ("state", "refusal"), {}),
    ],
    "SenderStatus": [
        Decider(sender_has_given_up, ("stage",), {"stage": msg.SenderStatus.STAGE_FAILED}),
    ],
}
ALWAYS = ("version", "header", "header.stamp")
"""Without these nobody acts on a status."""
ROS = {"header.seq": "rospy's counter", "header.frame_id": "a status has no frame"}
SHOWN = "a sentence or name that people read"
RESULT = "a figure of reports, of the manifest and of the console"
NOBODY: dict[str, dict[str, str]] = {
    "TeleopStatus": {
        "picture": SHOWN,
        "hands.scale": RESULT,
        "hands.mapping": "the console sets it by value and need not know it",
        "hands.detail": SHOWN,
    },
    "PolicyStatus": {
        "reason": "why the policy does not run, as a code: the state already says that it does not",
        **dict.fromkeys(("detail", "warning", "refused", "client", "policy", "address"), SHOWN),
        **dict.fromkeys(("session", "episode", "queue", "period", "accepted", "clipped"), RESULT),
        **dict.fromkeys(("rejected", "rejected_rules", "rejected_by_rule", "late"), RESULT),
        **dict.fromkeys(("stale", "empty", "waited", "messages", "malformed", "sessions"), RESULT),
        **dict.fromkeys(("malformed_codes", "flooded", "strangers", "obs_age_p50"), RESULT),
        **dict.fromkeys(("obs_age_p99", "round_trip_p50", "round_trip_p99"), RESULT),
    },
    "RecordStatus": {
        **dict.fromkeys(("detail", "folder", "finished", "stage", "warnings"), SHOWN),
        **dict.fromkeys(("tick", "segments", "backlog_rows", "backlog_frames"), RESULT),
        **dict.fromkeys(("waiting_for", "silent_cameras", "streams", "streams.name"), SHOWN),
        **dict.fromkeys(("streams.kind", "streams.received", "streams.dropped"), RESULT),
        "streams.future": RESULT,
    },
    "SimStatus": {
        **dict.fromkeys(("detail", "task.name", "task.setting", "task.phase"), SHOWN),
        **dict.fromkeys(("task.detail", "faults"), SHOWN),
        **dict.fromkeys(("mode", "sim_time", "deterministic", "state_hash", "overruns"), RESULT),
        "task.seed": RESULT,
    },
    "CalibrationStatus": {
        **dict.fromkeys(("hint", "missing", "result", "folder"), SHOWN),
        **dict.fromkeys(("views", "wanted", "progress", "residual"), RESULT),
        **dict.fromkeys(("columns", "rows", "fields", "needed", "corners"), "drawn on the picture"),
    },
    "DriftStatus": {
        **dict.fromkeys(("cause", "detail"), SHOWN),
        **dict.fromkeys(("least", "expected", "most", "since"), RESULT),
    },
    "SenderStatus": {
        **dict.fromkeys(("detail", "motion", "mode"), SHOWN),
        **dict.fromkeys(("refused", "scale", "duration", "begin", "end"), RESULT),
    },
}
CASES = [
    pytest.param(kind, decider, id=f"{kind}-{decider.call.__name__}")
    for kind, deciders in DECIDERS.items()
    for decider in deciders
]


@pytest.mark.parametrize("kind", sorted(DECIDERS))
def test_every_field_is_classified_once(kind: str) -> None:
    decided = {field for decider in DECIDERS[kind] for field in decider.fields} | {*ALWAYS}
    shown = ROS.keys() | NOBODY[kind].keys()
    assert not decided & shown
    assert decided | shown == {path for path, _, _ in fields(complete(kind))}


@pytest.mark.parametrize(("kind", "decider"), CASES)
def test_a_removed_field_never_becomes_a_yes(
    kind: str, decider: Decider, monkeypatch: pytest.MonkeyPatch
) -> None:
    status = complete(kind, decider.given)
    assert says_yes(decider, status, monkeypatch), "a complete status"
    for path, part, name in fields(status):
        enumerated = _holds_enumeration(part, name)
        decides = path in decider.fields or path in ALWAYS or enumerated
        answer = says_yes(decider, removed(status, path), monkeypatch)
        assert answer is not decides, f"without {path}"


def _holds_enumeration(part: Any, name: str) -> bool:
    """Whether the field, or a message in it, is an enumeration: 0 makes the status invalid."""
    content = getattr(part, name)
    inside = content.__slots__ if hasattr(content, "_slot_types") else ()
    return bool(values(part, name)) or any(_holds_enumeration(content, inner) for inner in inside)
