"""The newest joint states of a running arm, for the question whether it rests."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np
import rospy
from sensor_msgs.msg import JointState

import surg_core
from surg_core.standstill import REST_S, resting
from surg_core.transforms import FloatArray
from surg_ros.joint_order import positions_of

SILENT_S = 2.0
"""Silence of pictures or joints after which the person is told."""


class ArmJoints:
    """Listens to an arm's ``measured_js`` until `close`. Any thread may call it."""

    def __init__(self, arm: surg_core.Arm) -> None:
        self.topic = f"/{arm.name}/robot/measured_js"
        self._names = list(arm.robot.joint_names)
        self._lock = threading.Lock()
        self._states: deque[tuple[float, FloatArray]] = deque()
        self._listener: Any = rospy.Subscriber(
            self.topic, JointState, self._on_joints, queue_size=1000, tcp_nodelay=True
        )

    def silent(self, stamp: float) -> bool:
        """Whether no state has come for two seconds before a time [s]."""
        with self._lock:
            return not self._states or stamp - self._states[-1][0] > SILENT_S

    def resting(self, stamp: float) -> FloatArray | None:
        """As `standstill.resting`, of the arm at a time [s]."""
        with self._lock:
            states = list(self._states)
        return resting(states, stamp)

    def close(self) -> None:
        """Stop listening."""
        self._listener.unregister()

    def _on_joints(self, message: JointState) -> None:
        q = positions_of(message, self._names)
        if len(q) != len(self._names) or message.header.stamp.to_nsec() == 0:
            return
        with self._lock:
            states, now = self._states, message.header.stamp.to_sec()
            if states and now <= states[-1][0]:
                states.clear()
            states.append((now, np.array(q)))
            while now - states[0][0] > 4 * REST_S:
                states.popleft()
