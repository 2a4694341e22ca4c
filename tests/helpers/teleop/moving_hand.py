"""A CRTK leader as a lab would have it: a thread that publishes 100 poses a second."""

from __future__ import annotations

import threading
import time

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool


class MovingHand:
    """The leader ``/hand``, its gripper closed, and the switch of the teleoperation.

    Attributes:
        p: (3,) where it is [m].
        v: (3,) how it moves [m/s].
        q: (4,) how it is turned, x, y, z, w.
        speaks: Cleared: it is silent.
        enable: Switches the teleoperation on and off.
        inputs: Subscribers that end with it.
    """

    def __init__(self) -> None:
        self.p, self.v = np.zeros(3), np.zeros(3)
        self.q = np.array([0.0, 0.0, 0.0, 1.0])
        self.speaks = threading.Event()
        self.speaks.set()
        self.enable = rospy.Publisher("/console/teleop/enable", Bool, queue_size=1)
        self.inputs: list[rospy.Subscriber] = []
        self._stop = threading.Event()
        self._pose = rospy.Publisher("/hand/measured_cp", PoseStamped, queue_size=1)
        self._grip = rospy.Publisher("/hand/gripper/measured_js", JointState, queue_size=1)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def outputs(self) -> list[rospy.Publisher]:
        """What somebody must listen to."""
        return [self._pose, self._grip, self.enable]

    def _run(self) -> None:
        last = time.monotonic()
        while not self._stop.wait(0.01):
            now = time.monotonic()
            self.p, last = self.p + self.v * (now - last), now
            if not self.speaks.is_set():
                continue
            pose = PoseStamped()
            pose.header.stamp = rospy.Time.now()
            pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = self.p
            turned = pose.pose.orientation
            turned.x, turned.y, turned.z, turned.w = self.q
            self._pose.publish(pose)
            grip = JointState(name=["gripper"], position=[0.0])
            grip.header.stamp = pose.header.stamp
            self._grip.publish(grip)

    def close(self) -> None:
        """Leave."""
        self._stop.set()
        self._thread.join()
        for end in (*self.inputs, *self.outputs()):
            end.unregister()
