"""The topics of a CRTK leader, put into a :class:`~surg_teleop.leaders.bundled.crtk.CrtkLeader`."""

from __future__ import annotations

import threading
import time

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState

from crtk_msgs.msg import OperatingState
from surg_teleop.follow.message_lateness import Arrivals
from surg_teleop.leaders.bundled.crtk import FRESH, CrtkLeader

HANDS = ("measured_cp", "measured_cv", "spherical/measured_js")
"""Topics that say what the hand does: what is late on them is not followed."""
JOINTS = ("yaw", "pitch", "insertion", "roll")
"""Virtual joints about the trocar, in this order."""


class CrtkTopics:
    """Subscribes to one leader."""

    def __init__(self, leader: CrtkLeader, lock: threading.Lock, wake: threading.Event) -> None:
        self._leader, self._lock, self._wake = leader, lock, wake
        self._arrivals = {topic: Arrivals() for topic in HANDS}
        at = f"/{leader.name}"
        for topic, kind, callback in (
            ("measured_cp", PoseStamped, self._on_pose),
            ("measured_cv", TwistStamped, self._on_rate),
            ("spherical/measured_js", JointState, self._on_spherical),
            ("gripper/measured_js", JointState, self._on_grip),
            ("operating_state", OperatingState, self._on_state),
        ):
            rospy.Subscriber(f"{at}/{topic}", kind, callback, queue_size=None, tcp_nodelay=True)

    def _came(self, topic: str, stamp: rospy.Time) -> float:
        """When a message would have come without what held it up; with the lock held."""
        now = time.monotonic()
        at = self._arrivals[topic].of(stamp.to_sec(), now)
        if now - at > FRESH:
            self._leader.on_late(now, now - at)
        return at

    def _on_pose(self, message: PoseStamped) -> None:
        p, q = message.pose.position, message.pose.orientation
        stamp = message.header.stamp
        with self._lock:
            self._leader.on_pose(
                self._came("measured_cp", stamp),
                np.array([p.x, p.y, p.z]),
                np.array([q.x, q.y, q.z, q.w]),
                valid=not stamp.is_zero(),
            )
        self._wake.set()

    def _on_rate(self, message: TwistStamped) -> None:
        v, w = message.twist.linear, message.twist.angular
        stamp = message.header.stamp
        with self._lock:
            self._leader.on_rate(
                self._came("measured_cv", stamp),
                np.array([v.x, v.y, v.z]),
                np.array([w.x, w.y, w.z]),
                valid=not stamp.is_zero(),
            )
        self._wake.set()

    def _on_spherical(self, message: JointState) -> None:
        stamp = message.header.stamp
        if tuple(message.name) != JOINTS or len(message.velocity) != len(JOINTS):
            rospy.logwarn_throttle(
                5.0,
                f"/{self._leader.name}/spherical/measured_js: names {list(message.name)} with "
                f"{len(message.velocity)} velocities; needed are the velocities of "
                f"{', '.join(JOINTS)}",
            )
            return
        with self._lock:
            self._leader.on_spherical(
                self._came("spherical/measured_js", stamp),
                np.array(message.velocity),
                valid=not stamp.is_zero(),
            )
        self._wake.set()

    def _on_grip(self, message: JointState) -> None:
        if message.position:
            with self._lock:
                self._leader.on_grip(time.monotonic(), message.position[0])

    def _on_state(self, message: OperatingState) -> None:
        with self._lock:
            self._leader.on_state(message.state)
