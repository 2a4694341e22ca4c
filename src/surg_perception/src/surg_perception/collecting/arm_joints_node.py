"""The newest joint states of a running arm, for the question whether it rests."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np
import rospy
from sensor_msgs.msg import JointState

import surg_core
from surg_core.standstill import REST_S
from surg_core.transforms import FloatArray


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

    def states(self) -> list[tuple[float, FloatArray]]:
        """Times [s] and positions (n,) [rad] of the last seconds, oldest first."""
        with self._lock:
            return list(self._states)

    def close(self) -> None:
        """Stop listening."""
        self._listener.unregister()

    def _on_joints(self, message: JointState) -> None:
        where = dict(zip(message.name, message.position, strict=False)) if message.name else {}
        known = set(self._names) <= set(where)
        q = [where[name] for name in self._names] if known else list(message.position)
        if len(q) != len(self._names) or message.header.stamp.to_nsec() == 0:
            return
        with self._lock:
            states, now = self._states, message.header.stamp.to_sec()
            if states and now <= states[-1][0]:
                states.clear()
            states.append((now, np.array(q)))
            while now - states[0][0] > 4 * REST_S:
                states.popleft()
