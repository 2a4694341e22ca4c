"""The topics of a CRTK leader, put into a :class:`~surg_teleop.leaders.crtk.CrtkLeader`."""

from __future__ import annotations

import threading
import time

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState

from crtk_msgs.msg import OperatingState
from surg_teleop.leaders.crtk import CrtkLeader


class CrtkTopics:
    """Subscribes to one leader.

    Args:
        leader: Takes what comes.
        lock: Held while it does.
        wake: Set when there is something new.
    """

    def __init__(self, leader: CrtkLeader, lock: threading.Lock, wake: threading.Event) -> None:
        self._leader, self._lock, self._wake = leader, lock, wake
        at = f"/{leader.name}"
        for topic, kind, callback in (
            ("measured_cp", PoseStamped, self._on_pose),
            ("measured_cv", TwistStamped, self._on_rate),
            ("gripper/measured_js", JointState, self._on_grip),
            ("operating_state", OperatingState, self._on_state),
        ):
            rospy.Subscriber(f"{at}/{topic}", kind, callback, queue_size=None, tcp_nodelay=True)

    def _on_pose(self, message: PoseStamped) -> None:
        p, q = message.pose.position, message.pose.orientation
        with self._lock:
            self._leader.on_pose(
                time.monotonic(),
                np.array([p.x, p.y, p.z]),
                np.array([q.x, q.y, q.z, q.w]),
                valid=not message.header.stamp.is_zero(),
            )
        self._wake.set()

    def _on_rate(self, message: TwistStamped) -> None:
        v, w = message.twist.linear, message.twist.angular
        with self._lock:
            self._leader.on_rate(
                time.monotonic(),
                np.array([v.x, v.y, v.z]),
                np.array([w.x, w.y, w.z]),
                valid=not message.header.stamp.is_zero(),
            )
        self._wake.set()

    def _on_grip(self, message: JointState) -> None:
        if message.position:
            with self._lock:
                self._leader.on_grip(message.position[0])

    def _on_state(self, message: OperatingState) -> None:
        with self._lock:
            self._leader.on_state(message.state)
