"""Valid status messages, to publish as the nodes do, and to break on purpose."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any

import rospy

from surg_core.status_check import LatestStatus, values
from surg_msgs import msg
from surg_msgs.msg import HandStatus, RecordStatus, SimStatus, TaskStatus, TeleopStatus


def stamped(message: Any) -> Any:
    """The message with its version and the time."""
    message.version = message.VERSION
    message.header.stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
    return message


def teleop_status(state: str = "DISABLED", arm: str = "PSM1", **more: Any) -> TeleopStatus:
    """One hand on one arm; further fields of HandStatus."""
    mapping = getattr(HandStatus, f"MAPPING_{more.pop('mapping', 'position').upper()}")
    hand = HandStatus("hand", arm, getattr(HandStatus, f"STATE_{state}"), mapping, 0.2, "")
    for name, value in more.items():
        setattr(hand, name, value)
    return stamped(TeleopStatus(hands=[hand]))


def sim_status(state: str = "RUNNING", task: str = "NONE", **more: Any) -> SimStatus:
    """A simulator in lock-step; further fields of SimStatus; ``name`` and ``phase`` of the task."""
    about = TaskStatus(
        state=getattr(TaskStatus, f"STATE_{task}"),
        name=more.pop("name", ""),
        phase=more.pop("phase", ""),
    )
    number = getattr(SimStatus, f"STATE_{state}")
    mode = SimStatus.MODE_LOCKSTEP
    return stamped(SimStatus(state=number, mode=mode, task=about, **more))


def record_status(state: str = "IDLE", **more: Any) -> RecordStatus:
    """A recorder without a problem; further fields of RecordStatus."""
    number, problem = getattr(RecordStatus, f"STATE_{state}"), RecordStatus.PROBLEM_NONE
    return stamped(RecordStatus(state=number, problem=problem, **more))


def complete(kind: str, given: Mapping[str, Any] | None = None) -> Any:
    """A valid status without a default value in any field.

    Args:
        kind: Name of the message.
        given: Values by path, such as ``task.state``; an enumeration has its first value otherwise.
    """
    message = _filled(getattr(msg, kind))
    if kind == "PolicyStatus":
        message.state = message.STATE_READY
    if kind == "TeleopStatus":
        message.hands[0].arm = "PSM1"
    for path, value in (given or {}).items():
        _put(message, path, value)
    return stamped(message)


def _filled(kind: type[Any]) -> Any:
    simple = {"string": "text", "bool": True, "time": rospy.Time(7), "float64": 0.5}
    message = kind()
    for name, slot_type in zip(kind.__slots__, kind._slot_types, strict=True):
        base = slot_type.removesuffix("[]")
        value: Any = simple.get(base, 200)
        if "/" in base:
            value = _filled(type(message.header) if name == "header" else _part(base))
        elif known := values(kind, name):
            value = min(known)
        setattr(message, name, [value] if slot_type.endswith("[]") else value)
    return message


def _part(slot_type: str) -> type[Any]:
    return getattr(msg, slot_type.partition("/")[2])  # type: ignore[no-any-return]


def fields(message: Any, path: str = "") -> Iterator[tuple[str, Any, str]]:
    """(path, the part that holds it, name) of every field, through parts and lists of parts."""
    for name in message.__slots__:
        content = getattr(message, name)
        yield f"{path}{name}", message, name
        for part in content if isinstance(content, list) else [content]:
            if hasattr(part, "_slot_types"):
                yield from fields(part, f"{path}{name}.")


def removed(message: Any, path: str) -> Any:
    """The message with the default value in one field."""
    copy = deepcopy(message)
    part, name = next((part, name) for at, part, name in fields(copy) if at == path)
    setattr(part, name, getattr(type(part)(), name))
    return copy


def _put(message: Any, path: str, value: Any) -> None:
    part, name = next((part, name) for at, part, name in fields(message) if at == path)
    setattr(part, name, value)


def newest(topic: str, message: Any, received: float = 0.0) -> LatestStatus:
    """The newest status of a topic; None: none has come."""
    heard = LatestStatus(topic)
    if message is not None:
        heard.take(message, received)
    return heard


def heard_by_watch(statuses: Mapping[str, Any], **attributes: Any) -> Any:
    """The command line's `Watch` after these statuses by topic, without ROS.

    Args:
        statuses: By topic; None: nothing was heard there.
        **attributes: Of the watch, in place of what its other topics would fill in.
    """
    from surg_cli.graph.watch import Watch

    watch = Watch.__new__(Watch)
    kinds = {
        "/record/status": msg.RecordStatus,
        "/sim/status": msg.SimStatus,
        "/policy/status": msg.PolicyStatus,
        "/expert/status": msg.SenderStatus,
    }
    watch.__dict__.update(
        _lock=threading.Lock(),
        _kinds=kinds,
        _statuses={topic: LatestStatus(topic) for topic in kinds},
        _sim_changed=0.0,
        recording=False,
        _gave_up={},
        _fault=None,
        _errors={},
    )
    watch.__dict__.update(attributes)
    for topic, message in statuses.items():
        if message is not None:
            watch._on_status(message, topic)
    return watch


class TeleopSpeaker:
    """Repeats a teleoperation status as the node does, until it is closed."""

    def __init__(self, topic: str = "/teleop/status", period: float = 0.25) -> None:
        self.publisher = rospy.Publisher(topic, TeleopStatus, queue_size=1)
        self._state, self._period = "", period
        self._ended = threading.Event()
        threading.Thread(target=self._repeat, daemon=True).start()

    def say(self, state: str) -> None:
        """From now on the hand is in this state; empty: silence."""
        self._state = state
        if state:
            self.publisher.publish(teleop_status(state))

    def close(self) -> None:
        """Fall silent."""
        self._ended.set()
        self.publisher.unregister()

    def _repeat(self) -> None:
        while not self._ended.wait(self._period):
            self.say(self._state)
