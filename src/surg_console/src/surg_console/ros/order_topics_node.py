"""Publishes the orders of the console."""

from __future__ import annotations

import time

import numpy as np
import rospy
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Empty, Float64, String

from crtk_msgs.msg import StringStamped
from surg_console.session import console_orders as orders
from surg_console.web.page_protocol import Input
from surg_core.hand.leader_sample import HandlePose, HandRate, LeaderSample
from surg_msgs.msg import CalibrationRequest
from surg_ros.leader_port import LeaderTopics, joy_message, wall_time

REPEAT = 0.05
"""[s] Held buttons are re-published at this interval."""
KINDS = {
    orders.EnableTeleop.topic: Bool,
    orders.SetMapping.topic: Bool,
    orders.SetScale.topic: Float64,
    orders.Record.topic: Bool,
    orders.Policy.topic: Bool,
    orders.SetOperatorPresent.topic: Joy,
    orders.Clutch.topic: Joy,
    orders.Camera.topic: Joy,
    orders.Calibrate.topic: CalibrationRequest,
    "/sim/guide_home": String,
    orders.Describe.topic: String,
    orders.NewEpisode.topic: Empty,
}


class OrderTopics:
    """Topics of the orders; without the leader's namespace the page is no leader."""

    def __init__(self, arms: tuple[str, ...], leader: str) -> None:
        self._held: dict[str, bool] = {}
        self._repeated = -1e9
        self._leader = LeaderTopics(leader, spherical=False) if leader else None
        kinds = KINDS | {f"/{arm}/state_command": StringStamped for arm in arms}
        self._topics = {
            topic: rospy.Publisher(topic, kind, queue_size=10, tcp_nodelay=True)
            for topic, kind in kinds.items()
        }

    def send(self, order: orders.Order) -> None:
        """Publish one order."""
        if isinstance(order, orders.Button):
            self._held[order.topic] = bool(order.value)
            self._press(order.topic, bool(order.value))
        elif isinstance(order, orders.Calibrate):
            request = getattr(CalibrationRequest, str(order.value))
            self._topics[order.topic].publish(request)
        elif isinstance(order, orders.NewEpisode):
            self._topics[order.topic].publish()
        elif isinstance(order, orders.Request):
            self._topics[order.topic].publish(order.value)
        elif isinstance(order, orders.StateCommand):
            message = StringStamped(string=order.word)
            message.header.stamp = rospy.Time.now()
            self._topics[f"/{order.arm}/state_command"].publish(message)
        elif isinstance(order, orders.Move) and self._leader is not None:
            self._leader.publish(leader_sample(order.sample), wall_time())

    def repeat(self) -> None:
        """Re-publish held buttons when due."""
        now = time.monotonic()
        if now - self._repeated >= REPEAT:
            self._repeated = now
            for topic, on in self._held.items():
                self._press(topic, on)

    def _press(self, topic: str, on: bool) -> None:
        self._topics[topic].publish(joy_message([on], wall_time()))


def leader_sample(page: Input) -> LeaderSample:
    """An input of the page as a leader's sample: the part that its kind of hand drives."""
    if page.hand == "position":
        pose = HandlePose(np.array(page.p), np.array(page.q))
        return LeaderSample(page.at, pose=pose, grip=page.grip)
    rate = HandRate(np.array(page.v), page.roll_rate, tilt=np.array(page.tilt))
    return LeaderSample(page.at, rate=rate, grip=page.grip)
