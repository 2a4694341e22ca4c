"""Asks the links of a running cell about their robots, and to start, stop or guide them."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from surg_cli.graph.processes import wait_until

CONNECT_S, ANSWER_S = 3.0, 15.0
"""[s] For the links to be heard; for a robot to do what was asked: its server may take 10."""


@dataclass
class Heard:
    """What one arm's link has said."""

    status: Any = None  # the newest surg_msgs/LinkStatus
    said: list[str] = field(default_factory=list)  # its warnings, for people


def condition_name(status: Any) -> str:
    """The condition of a LinkStatus in words."""
    from surg_core import RobotCondition

    names = {int(value): name for name, value in RobotCondition.__members__.items()}
    return names.get(int(status.condition), f"unknown ({status.condition})")


def reached(word: str, condition: str) -> bool:
    """Whether a robot in this condition does what a request asks for."""
    if word == "start":
        return condition == "ACTIVE"
    if word == "guide":
        return condition == "GUIDED"
    if word == "recover":
        return condition not in ("STOPPED", "BROKEN", "OFFLINE")
    return condition not in ("ACTIVE", "GUIDED")


class RobotRequests:
    """Speaks with the links of some arms; rospy has been initialised."""

    def __init__(self, arms: Sequence[str]) -> None:
        import rospy
        from std_msgs.msg import String

        from crtk_msgs.msg import StringStamped
        from surg_msgs.msg import LinkStatus

        self._lock = threading.Lock()
        self._heard = {arm: Heard() for arm in arms}
        self._message = StringStamped
        self._out = {
            arm: rospy.Publisher(f"/{arm}/robot/request", StringStamped, queue_size=1)
            for arm in arms
        }
        for arm in arms:
            rospy.Subscriber(f"/{arm}/robot/status", LinkStatus, self._on_status, arm)
            rospy.Subscriber(f"/{arm}/warning", String, self._on_warning, arm)

    def statuses(self) -> Mapping[str, Any]:
        """Arm -> its newest status; None: its link is not heard."""
        wait_until(lambda: None not in self._statuses().values(), CONNECT_S)
        return self._statuses()

    def _statuses(self) -> Mapping[str, Any]:
        with self._lock:
            return {arm: heard.status for arm, heard in self._heard.items()}

    def condition(self, arm: str) -> str:
        """The condition of an arm's robot now; empty: its link is not heard."""
        status = self._statuses()[arm]
        return "" if status is None else condition_name(status)

    def send(self, arm: str, word: str) -> None:
        """Send a request, and wait for nothing."""
        self._out[arm].publish(self._message(string=word))

    def ask(self, arm: str, word: str) -> str:
        """Send a request and wait until the robot does it; returns why not, or nothing."""
        if self.statuses()[arm] is None:
            return "its link says nothing"
        if not wait_until(lambda: self._out[arm].get_num_connections() > 0, CONNECT_S):
            return "its link takes no requests: it was started by hand"
        with self._lock:
            self._heard[arm].said.clear()
        self.send(arm, word)
        heard = self._heard[arm]

        def done() -> bool:
            return reached(word, condition_name(heard.status))

        wait_until(lambda: done() or any(f": {word}: " in each for each in heard.said), ANSWER_S)
        if done():
            return ""
        with self._lock:
            return "; ".join(heard.said) or heard.status.fault or "the robot did not do it"

    def _on_status(self, message: Any, arm: str) -> None:
        with self._lock:
            self._heard[arm].status = message

    def _on_warning(self, message: Any, arm: str) -> None:
        with self._lock:
            self._heard[arm].said.append(message.data)
