"""Publishes the orders of the console."""

from __future__ import annotations

import math
import time

import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState, Joy
from std_msgs.msg import Bool, Float64, String

from crtk_msgs.msg import StringStamped
from surg_teleop.console.session.console_orders import (
    Camera,
    Clutch,
    Follow,
    Move,
    Order,
    OtherMapping,
    Policy,
    Present,
    PutBack,
    Record,
    SetScale,
    StateCommand,
)
from surg_teleop.console.web.page_protocol import Input

REPEAT = 0.05
"""[s] Held buttons are re-published at this interval; receivers drop silent sources."""


class OrderTopics:
    """Topics of the orders.

    Args:
        arms: CRTK names.
        leader: Namespace of the leader's topics; empty: the page is not a leader.
    """

    def __init__(self, arms: tuple[str, ...], leader: str) -> None:
        self._held: dict[str, bool] = {}
        self._repeated = -1e9
        self._topics = _publishers(arms, leader)

    def send(self, order: Order) -> None:
        """Publish one order."""
        topics = self._topics
        if isinstance(order, Move):
            self._move(order.sample)
        elif isinstance(order, Present):
            self._hold("/console/operator_present", order.on)
        elif isinstance(order, Follow):
            topics["/console/teleop/enable"].publish(order.on)
        elif isinstance(order, Clutch):
            self._hold("/console/clutch", order.on)
        elif isinstance(order, Camera):
            self._hold("/console/camera", order.on)
        elif isinstance(order, OtherMapping):
            topics["/console/rate"].publish(_joy(True))
            rospy.Timer(
                rospy.Duration.from_sec(0.06),
                lambda event: topics["/console/rate"].publish(_joy(False)),
                oneshot=True,
            )
        elif isinstance(order, SetScale):
            topics["/console/teleop/set_scale"].publish(order.value)
        elif isinstance(order, Record):
            topics["/record/record"].publish(order.on)
        elif isinstance(order, PutBack):
            topics["/sim/by_hand"].publish(order.arm)
        elif isinstance(order, Policy):
            topics["/policy/enable"].publish(order.on)
        elif isinstance(order, StateCommand):
            message = StringStamped(string=order.word)
            message.header.stamp = rospy.Time.now()
            topics[f"/{order.arm}/state_command"].publish(message)

    def _hold(self, topic: str, on: bool) -> None:
        self._held[topic] = on
        self._topics[topic].publish(_joy(on))

    def repeat(self) -> None:
        """Re-publish held buttons when due."""
        now = time.monotonic()
        if now - self._repeated >= REPEAT:
            self._repeated = now
            for topic, on in self._held.items():
                self._topics[topic].publish(_joy(on))

    def _move(self, sample: Input) -> None:
        stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
        if sample.hand == "position":
            pose = PoseStamped()
            pose.header.stamp = stamp
            p, q = pose.pose.position, pose.pose.orientation
            p.x, p.y, p.z = sample.p
            q.z, q.w = half_turn(sample.roll)
            self._topics["measured_cp"].publish(pose)
        else:
            twist = TwistStamped()
            twist.header.stamp = stamp
            v = twist.twist.linear
            v.x, v.y, v.z = sample.v
            twist.twist.angular.z = sample.roll_rate
            self._topics["measured_cv"].publish(twist)
        if sample.grip is not None:
            grip = JointState(name=["gripper"], position=[sample.grip])
            grip.header.stamp = stamp
            self._topics["gripper"].publish(grip)


def _publishers(arms: tuple[str, ...], leader: str) -> dict[str, rospy.Publisher]:
    def publisher(topic: str, kind: type, queue: int = 10) -> rospy.Publisher:
        return rospy.Publisher(topic, kind, queue_size=queue, tcp_nodelay=True)

    topics = {
        "/record/record": publisher("/record/record", Bool),
        "/policy/enable": publisher("/policy/enable", Bool),
        "/sim/by_hand": publisher("/sim/by_hand", String),
        "/console/teleop/enable": publisher("/console/teleop/enable", Bool),
        "/console/teleop/set_scale": publisher("/console/teleop/set_scale", Float64),
    }
    if leader:
        topics["measured_cp"] = publisher(f"/{leader}/measured_cp", PoseStamped, 1)
        topics["measured_cv"] = publisher(f"/{leader}/measured_cv", TwistStamped, 1)
        topics["gripper"] = publisher(f"/{leader}/gripper/measured_js", JointState, 1)
    for name in ("operator_present", "clutch", "camera", "rate"):
        topics[f"/console/{name}"] = publisher(f"/console/{name}", Joy)
    for arm in arms:
        topics[f"/{arm}/state_command"] = publisher(f"/{arm}/state_command", StringStamped)
    return topics


def half_turn(angle: float) -> tuple[float, float]:
    """Components z and w of the quaternion of a rotation about z [rad]."""
    return math.sin(angle / 2.0), math.cos(angle / 2.0)


def _joy(on: bool) -> Joy:
    message = Joy(buttons=[int(on)])
    message.header.stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
    return message
