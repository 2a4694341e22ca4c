"""The topics of a CRTK leader, put into a :class:`~surg_teleop.leaders.bundled.crtk.CrtkLeader`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState

from crtk_msgs.msg import OperatingState
from surg_core.contract import VIRTUAL_JOINTS
from surg_core.hand.message_lateness import Arrivals
from surg_teleop.leaders.bundled.crtk import FRESH, CrtkLeader


class CrtkTopics:
    """Subscribes to one leader, which takes messages under `lock`; motions set `wake`."""

    def __init__(self, leader: CrtkLeader, lock: threading.Lock, wake: threading.Event) -> None:
        self._leader, self._lock, self._wake = leader, lock, wake
        for topic, kind, callback in (
            ("measured_cp", PoseStamped, self._motion(self._on_pose)),
            ("measured_cv", TwistStamped, self._motion(self._on_rate)),
            ("spherical/measured_js", JointState, self._motion(self._on_spherical)),
            ("gripper/measured_js", JointState, self._on_grip),
            ("operating_state", OperatingState, self._on_state),
        ):
            name = f"/{leader.name}/{topic}"
            rospy.Subscriber(name, kind, callback, queue_size=None, tcp_nodelay=True)

    def _motion(self, take: Callable[[Any, float], None]) -> Callable[[Any], None]:
        """Callback of a topic that tells what the hand does; late messages are not followed."""
        arrivals = Arrivals()

        def on_message(message: Any) -> None:
            stamp = message.header.stamp
            if stamp.is_zero():  # CRTK's "not valid" counts as silence
                return
            with self._lock:
                now = time.monotonic()
                arrival = arrivals.of(stamp.to_sec(), now)
                if now - arrival > FRESH:
                    self._leader.on_late(now, now - arrival)
                take(message, arrival)
            self._wake.set()

        return on_message

    def _on_pose(self, message: PoseStamped, arrival: float) -> None:
        p, q = message.pose.position, message.pose.orientation
        self._leader.on_pose(arrival, np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w]))

    def _on_rate(self, message: TwistStamped, arrival: float) -> None:
        v, w = message.twist.linear, message.twist.angular
        self._leader.on_rate(arrival, np.array([v.x, v.y, v.z]), np.array([w.x, w.y, w.z]))

    def _on_spherical(self, message: JointState, arrival: float) -> None:
        if tuple(message.name) == VIRTUAL_JOINTS and len(message.velocity) == len(VIRTUAL_JOINTS):
            self._leader.on_spherical(arrival, np.array(message.velocity))
            return
        rospy.logwarn_throttle(
            5.0,
            f"/{self._leader.name}/spherical/measured_js: names {list(message.name)} with "
            f"{len(message.velocity)} velocities; needed are the velocities of "
            f"{', '.join(VIRTUAL_JOINTS)}",
        )

    def _on_grip(self, message: JointState) -> None:
        if message.position:
            with self._lock:
                self._leader.on_grip(time.monotonic(), message.position[0])

    def _on_state(self, message: OperatingState) -> None:
        with self._lock:
            self._leader.on_state(message.state)
