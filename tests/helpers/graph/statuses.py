"""Valid status messages, to publish as the nodes do, and to break on purpose."""

from __future__ import annotations

import threading
import time
from typing import Any

import rospy

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
