"""A kinematic Panda behind the link contract: `python panda_link.py __name:=panda_link`.

Another robot than the simulator's, written from docs/guide/adding_a_robot.md and
docs/reference/topics.md alone: it
takes a flange twist (`robot/servo_cv`), has an inverse kinematics of its own (damped least squares
on Denavit-Hartenberg parameters as Franka publishes them) and a dead-man of its own: without a
command for `DEAD_MAN` its joints come to rest. No physics. Imports nothing of the platform but its
messages.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import numpy as np
import rospy
from geometry_msgs.msg import TwistStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

sys.path.insert(0, str(Path(__file__).parents[2]))
from helpers.control.dh import PANDA, PANDA_FLANGE
from surg_msgs.msg import LinkStatus

Array = NDArray[np.float64]

JOINTS = [f"joint{n}" for n in range(1, 8)]
HOME = np.array([-0.147, -0.437, -0.073, -2.227, 0.367, 1.791, 0.044])
"""[rad] As in the robot's YAML."""
VELOCITY = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
"""[rad/s] Never exceeded: all joints slow down together."""
BRAKE = 8.0
"""[rad/s^2] Of each joint when the dead-man stops the arm."""
PERIOD, DEAD_MAN = 0.002, 0.04
"""[s]"""
DAMPING = 1e-3
POSTURE = 1.0
"""[1/s] Pull of the free joint to the home posture."""


def jacobian(q: Array) -> Array:
    """Of the flange in the base frame, (6, 7): linear rows first."""
    pose, axes, origins = np.eye(4), [], []
    for angle, (a, d, alpha) in zip(q, PANDA, strict=True):
        ct, st, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        pose = pose @ np.array(
            [
                [ct, -st, 0.0, a],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        axes.append(pose[:3, 2])
        origins.append(pose[:3, 3])
    flange = pose[:3, 3] + PANDA_FLANGE * pose[:3, 2]
    turn = np.array(axes).T
    return np.vstack([np.cross(turn.T, flange - np.array(origins)).T, turn])


def joint_velocities(q: Array, twist: Array) -> Array:
    """Joint velocities (7,) for a flange twist (6,): damped least squares, the rest to home."""
    J = jacobian(q)
    inverse = J.T @ np.linalg.inv(J @ J.T + DAMPING**2 * np.eye(6))
    qd = inverse @ twist + (np.eye(7) - inverse @ J) @ (POSTURE * (HOME - q))
    return qd / max(1.0, float(np.abs(qd / VELOCITY).max()))


class Link:
    """The arm and its tool."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.q, self.qd, self.jaw = HOME.copy(), np.zeros(7), 0.3
        self._twist = np.zeros(6)
        self._came, self._stamp, self.tick = -1e9, rospy.Time(0), 0
        speak = {"queue_size": 1, "tcp_nodelay": True}
        self._state = rospy.Publisher("/PSM1/robot/measured_js", JointState, **speak)
        self._status = rospy.Publisher("/PSM1/robot/status", LinkStatus, **speak)
        self._tool = rospy.Publisher("/PSM1/tool/measured_js", JointState, **speak)
        rospy.Subscriber("/PSM1/robot/servo_cv", TwistStamped, self._on_twist, tcp_nodelay=True)
        rospy.Subscriber("/PSM1/tool/servo_jp", JointState, self._on_jaw, tcp_nodelay=True)

    def _on_twist(self, message: TwistStamped) -> None:
        v, w = message.twist.linear, message.twist.angular
        twist = np.array([v.x, v.y, v.z, w.x, w.y, w.z])
        if np.isfinite(twist).all():
            with self._lock:
                self._twist, self._came = twist, time.monotonic()
                self._stamp = message.header.stamp

    def _on_jaw(self, message: JointState) -> None:
        if message.position and np.isfinite(message.position[0]):
            self.jaw = float(message.position[0])

    def step(self, now: float, dt: float) -> bool:
        """Move for a while; returns whether the dead-man does."""
        with self._lock:
            twist, silent = self._twist, now - self._came > DEAD_MAN
        if silent:
            self.qd = np.sign(self.qd) * np.maximum(np.abs(self.qd) - BRAKE * dt, 0.0)
        else:
            self.qd = joint_velocities(self.q, twist)
        self.q = self.q + dt * self.qd
        self.tick += 1
        return silent

    def publish(self, dead_man: bool) -> None:
        """Say where everything is."""
        stamp = rospy.Time.from_sec(time.time())
        status = LinkStatus(
            tick=self.tick,
            condition=LinkStatus.ACTIVE,
            command="cartesian_velocity",
            last_command=self._stamp,
            dead_man=dead_man,
            lockstep=False,
            speed_scaling=1.0,
            rate=1,
        )
        tool = JointState(name=["jaw"], position=[self.jaw], velocity=[0.0])
        state = JointState(name=JOINTS, position=self.q.tolist(), velocity=self.qd.tolist())
        for message in (status, tool, state):
            message.header.stamp = stamp
        self._status.publish(status)
        self._tool.publish(tool)
        self._state.publish(state)


def main() -> None:
    """Run at 500 Hz; what is missed beyond the dead-man is not caught up with."""
    rospy.init_node("panda_link")
    link = Link()
    due = last = time.monotonic()
    while not rospy.is_shutdown():
        now = time.monotonic()
        link.publish(link.step(now, min(now - last, DEAD_MAN)))
        last, due = now, max(due + PERIOD, now)
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main()
