"""A robot link, a tool link and an operator for tests of the controller node.

``Rig`` plays them in lock-step, tick by tick; ``real_time`` lets the same plant run by itself.
"""

from __future__ import annotations

import contextlib
import math
import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import surg_core
from crtk_msgs.msg import OperatingState, StringStamped
from helpers.graph.ros import RosGraph
from surg_cli.graph.processes import Child
from surg_cli.host import paths
from surg_msgs.msg import Cycle, LinkStatus, Ready
from surg_ros.byte_topics import listeners

CELL = paths.ROOT / "cells" / "sim_ur5e"
TICK_NS = 2_000_000
CONTROLLER = "/PSM1/controller"
ANSWER_S = 5.0  # of wall clock; only a broken controller needs it
SILENCE_S = 0.3


def stamp(tick: int) -> rospy.Time:
    """The stamp of a tick."""
    return rospy.Time(0, tick * TICK_NS)


class Rig:
    """A robot link with an ideal integrator, a tool link and an operator, in one rospy node.

    Attributes:
        arm: The cell's arm.
        q: Joint positions of the plant [rad].
        tick: Ticks stepped so far.
        answers: Robot commands as they came.
        tools: Tool commands as they came.
        cycles: Cycle messages as they came.
        texts: Every text of warning, status, error by topic.
        says: Members of the link's status.
    """

    def __init__(self, name: str, twist: bool = False) -> None:
        self.arm = surg_core.load_cell(CELL).arms["PSM1"]
        self.q = np.array(self.arm.robot.home)
        self.qd = np.zeros_like(self.q)
        self.tick = 0
        self.sent = 0
        self.name = name.lstrip("/")
        self.answers: queue.Queue[Any] = queue.Queue()
        self.tools: queue.Queue[JointState] = queue.Queue()
        self.cycles: queue.Queue[Cycle] = queue.Queue()
        self.texts: dict[str, list[str]] = {}
        self.states: list[OperatingState] = []
        self.says: dict[str, Any] = {"condition": LinkStatus.ACTIVE}
        self._changed = threading.Condition()
        self._subscribers = [
            self._listen("robot/servo_cv", TwistStamped, self.answers.put)
            if twist
            else self._listen("robot/servo_jv", JointState, self.answers.put),
            self._listen("tool/servo_jp", JointState, self.tools.put),
            self._listen("cycle", Cycle, self.cycles.put),
            self._listen("operating_state", OperatingState, self.states.append),
            self._listen("/sim/undeclared", String, self._text("undeclared")),
        ]
        for topic in ("warning", "status", "error"):
            self._subscribers.append(self._listen(topic, String, self._text(topic)))
        self.robot = self._speak("robot/measured_js", JointState)
        self.tool = self._speak("tool/measured_js", JointState)
        self.link = self._speak("robot/status", LinkStatus)
        self.servo_cp = self._speak("servo_cp", PoseStamped)
        self.servo_jp = self._speak("servo_jp", JointState)
        self.state_command = self._speak("state_command", StringStamped)
        self.ready = self._speak("/sim/ready", Ready)
        self._publishers = [
            self.robot, self.tool, self.link, self.servo_cp, self.servo_jp, self.state_command,
            self.ready,
        ]  # fmt: skip

    def _listen(self, topic: str, kind: type, callback: Callable[..., None]) -> rospy.Subscriber:
        full = topic if topic.startswith("/") else f"/PSM1/{topic}"
        return rospy.Subscriber(full, kind, callback, queue_size=None, tcp_nodelay=True)

    def _speak(self, topic: str, kind: type) -> rospy.Publisher:
        full = topic if topic.startswith("/") else f"/PSM1/{topic}"
        return rospy.Publisher(full, kind, queue_size=0, tcp_nodelay=True)

    def _text(self, topic: str) -> Callable[[String], None]:
        def keep(message: String) -> None:
            with self._changed:
                self.texts.setdefault(topic, []).append(message.data)
                self._changed.notify_all()

        return keep

    def connected(self, ready: bool = True) -> bool:
        """Whether the controller hears everything and is heard.

        By its name: a test that looks at a topic itself is a connection too.
        """
        publishers = [p for p in self._publishers if ready or p is not self.ready]
        return all(CONTROLLER in listeners(p) for p in publishers) and all(
            s.get_num_connections() > 0 for s in self._subscribers[:8] if "/sim/" not in s.name
        )

    def close(self) -> None:
        """Leave the graph."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        for publisher in self._publishers:
            publisher.unregister()

    def wait_text(self, topic: str, part: str) -> str:
        """Wait for a text that holds `part`; fail naming what came instead."""
        deadline = time.monotonic() + ANSWER_S
        with self._changed:
            while True:
                for text in self.texts.get(topic, []):
                    if part in text:
                        return text
                left = deadline - time.monotonic()
                assert left > 0, f"no {topic} with {part!r}; came: {self.texts}"
                self._changed.wait(left)

    def publish_state(self, tick: int) -> None:
        """The plant's state of a tick, robot and tool."""
        message = JointState(name=list(self.arm.robot.joint_names))
        message.header.stamp = stamp(tick)
        message.position = self.q.tolist()
        message.velocity = self.qd.tolist()
        self.robot.publish(message)
        self.publish_status(stamp(tick))
        tool = JointState(name=["jaw"], position=[0.2])
        tool.header.stamp = stamp(tick)
        self.tool.publish(tool)

    def publish_status(self, when: rospy.Time, lockstep: bool = True) -> None:
        """What the link says of the robot: `says` in each of its members."""
        said = {"lockstep": lockstep, "speed_scaling": 1.0, "rate": 1, **self.says}
        status = LinkStatus(**said)
        status.header.stamp = when
        self.link.publish(status)

    def publish_ready(self, tick: int, sent: int | None = None) -> None:
        """All is sent for this tick."""
        total = self.sent if sent is None else sent
        self.ready.publish(Ready(tick=tick, participant=self.name, arms=["PSM1"], sent=[total]))

    def say(self, word: str) -> None:
        """A state command."""
        self.state_command.publish(StringStamped(string=word))
        self.sent += 1

    def pose(self, p: np.ndarray, frame: str = "PSM1_rcm") -> None:
        """A servo_cp to a tip position in the rcm frame [m], roll 0."""
        message = PoseStamped()
        message.header.frame_id = frame
        message.pose.position.x, message.pose.position.y, message.pose.position.z = p
        message.pose.orientation.w = 1.0
        self.servo_cp.publish(message)
        self.sent += 1

    def step(self) -> Cycle:
        """State, Ready, answer, plant: one tick. Commands have been published before."""
        self.tick += 1
        self.publish_state(self.tick)
        self.publish_ready(self.tick)
        answer = self.answers.get(timeout=ANSWER_S)
        tool = self.tools.get(timeout=ANSWER_S)
        cycle = self.cycles.get(timeout=ANSWER_S)
        assert answer.header.stamp == tool.header.stamp == stamp(self.tick)
        assert cycle.header.stamp == stamp(self.tick)
        assert cycle.tick == self.tick
        assert cycle.period_us == 0.0
        assert np.all(np.isfinite(answer.velocity))
        assert list(cycle.qd_command) == list(answer.velocity)
        assert list(cycle.q) == self.q.tolist()
        self.qd = np.array(answer.velocity)
        self.q = self.q + self.qd * TICK_NS * 1e-9
        return cycle

    def enable(self) -> Cycle:
        """Home and enable: tick 1 shows the state, tick 2 homes, tick 3 enables."""
        self.step()
        self.say("home")
        assert self.step().homed
        self.say("enable")
        cycle = self.step()
        assert cycle.state == Cycle.ENABLED, self.texts
        return cycle


def start(graph: RosGraph, rig: Rig, env: dict[str, str] | None = None, **params: object) -> Child:
    """Start the controller with this process as its one participant and wait for it."""
    settings: dict[str, object] = {"cell": CELL, "arm": "PSM1", "participants": [rig.name]}
    settings.update(params)
    child = graph.node("surg_control", "rcm_node", CONTROLLER, settings, env=env)
    ready = settings.get("mode", "lockstep") == "lockstep"
    graph.wait_for(lambda: rig.connected(ready), 20.0, "the controller's connections")
    return child


def tip_in_rcm(cycle: Cycle) -> np.ndarray:
    """Measured tip of a cycle in the rcm frame [m]."""
    x, y, z, w = cycle.q_br
    R_BR = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return R_BR.T @ (np.array(cycle.p_tip) - np.array(cycle.p_rcm))


def follow(rig: Rig, ticks: int) -> list[Cycle]:
    """A smooth sideways motion, 4 mm in 500 ticks; returns its cycles."""
    cycle = rig.enable()
    p0 = tip_in_rcm(cycle)
    cycles = []
    for k in range(ticks):
        offset = 0.002 * (1.0 - math.cos(2 * math.pi * k / 1000))
        rig.pose(p0 + np.array([offset, 0.0, 0.0]))
        cycles.append(rig.step())
    return cycles


@contextlib.contextmanager
def real_time(rig: Rig, ahead_s: float = 0.0) -> Iterator[list[np.ndarray]]:
    """Run the plant in real time, about 500 Hz, stamps by the wall clock.

    Args:
        rig: Its plant; answers are taken from its queue.
        ahead_s: How far the stamps are in the future [s].

    Yields:
        The joint velocities that the controller sent, as they came [rad/s].
    """
    stop = threading.Event()
    sent: list[np.ndarray] = []

    def link() -> None:
        last = time.monotonic()
        while not stop.wait(0.002):
            now = time.monotonic()
            rig.q = rig.q + rig.qd * (now - last)
            last = now
            stamp_now = rospy.Time.from_sec(time.time() + ahead_s)
            message = JointState(name=list(rig.arm.robot.joint_names))
            message.header.stamp = stamp_now
            message.position, message.velocity = rig.q.tolist(), rig.qd.tolist()
            rig.robot.publish(message)
            rig.publish_status(stamp_now, lockstep=False)
            tool = JointState(name=["jaw"], position=[0.2])
            tool.header.stamp = stamp_now
            rig.tool.publish(tool)
            while not rig.answers.empty():
                rig.qd = np.array(rig.answers.get().velocity)
                sent.append(rig.qd)

    thread = threading.Thread(target=link)
    thread.start()
    try:
        yield sent
    finally:
        stop.set()
        thread.join()
