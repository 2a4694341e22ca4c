"""What the teleoperation publishes about itself: state topics, warnings and ``~status``."""

from __future__ import annotations

import math
import time

import rospy
from std_msgs.msg import Bool, Float64, String

from surg_core.contract import SECOND_NS
from surg_msgs.msg import HandStatus, TeleopStatus
from surg_teleop.follow.arm_switch import Hand
from surg_teleop.follow.teleop_types import TeleopOutput, TeleopState

STATE_TOPICS = {
    "current_state": String,
    "desired_state": String,
    "following": Bool,
    "scale": Float64,
    "rotation_locked": Bool,
    "translation_locked": Bool,
}
"""Latched topics of every leader on every arm, below ``/<leader>_<arm>``."""
WARNING_PERIOD = 1.0
"""[s] Shortest interval between two equal warnings."""
STATUS_PERIOD = 0.5
"""[s] Longest interval between two status messages."""


class TeleopStatusPublisher:
    """Publishes states, warnings and the status."""

    def __init__(self, hands: list[Hand]) -> None:
        self._hands = hands
        self._topics = {
            (arm, name): rospy.Publisher(
                f"/{hand.leader.name}_{arm}/{name}", kind, queue_size=10, latch=True
            )
            for hand in hands
            for arm in hand.switch.arms
            for name, kind in STATE_TOPICS.items()
        }
        self._warning = rospy.Publisher("~warning", String, queue_size=10)
        self._status = rospy.Publisher("~status", TeleopStatus, queue_size=2, latch=True)
        self._published: dict[tuple[str, str], object] = {}
        self._messages: dict[str, str] = {}
        self._warned: dict[str, float] = {}
        self._picture: str | None = None
        self._last_status: tuple[object, ...] = ()
        self._last_time = -math.inf

    def warn(self, text: str) -> None:
        """Log and publish a warning."""
        rospy.logwarn("%s", text)
        self._warning.publish(text)

    def state(self, hand: Hand, arm: str, output: TeleopOutput) -> None:
        """Publish what has changed for one arm, and warn of a new problem."""
        teleop = hand.switch.arms[arm]
        values: dict[str, object] = {
            "current_state": output.state.value,
            "desired_state": "DISABLED" if output.state is TeleopState.DISABLED else "FOLLOWING",
            "following": output.state is TeleopState.FOLLOWING,
            "scale": teleop.scale,
            "rotation_locked": teleop.lock_rotation,
            "translation_locked": teleop.lock_translation,
        }
        for name, value in values.items():
            if self._published.get((arm, name)) != value:
                self._published[arm, name] = value
                self._topics[arm, name].publish(value)
        # A device that cannot be opened is a better reason than its silence.
        message = hand.problem if hand.problem and output.message else output.message
        if message and self._messages.get(arm) != message:
            text, now = f"{hand.leader.name} on {arm}: {message}", time.monotonic()
            if now - self._warned.get(text, -math.inf) >= WARNING_PERIOD:
                self._warned[text] = now
                self.warn(text)
        self._messages[arm] = message

    def status(self, now: float, picture: str) -> None:
        """Publish the status on a change and periodically; `picture`: problem of the picture."""
        if picture and self._picture == "":
            self.warn(picture)
        self._picture = picture
        hands = [
            HandStatus(
                leader=hand.leader.name,
                arm=arm,
                state=getattr(HandStatus, f"STATE_{teleop.state.name}"),
                mapping=getattr(HandStatus, f"MAPPING_{teleop.mode.name}"),
                scale=teleop.scale,
                detail=self._messages.get(arm, ""),
            )
            for hand in self._hands
            for arm, teleop in hand.switch.arms.items()
        ]
        status = picture, *hands
        if status == self._last_status and now - self._last_time < STATUS_PERIOD:
            return
        self._last_status, self._last_time = status, now
        message = TeleopStatus(version=TeleopStatus.VERSION, hands=hands, picture=picture)
        message.header.stamp = rospy.Time(*divmod(time.time_ns(), SECOND_NS))
        self._status.publish(message)
