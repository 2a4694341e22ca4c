"""Any leader as a process of its own, on topics: what ROS's ``joy`` does, and CRTK.

Publishes below ``/<name>`` what the leader has: ``joy`` (on every change and at the layout's
autorepeat), ``measured_cp`` and ``measured_cv`` in the view frame, ``spherical/measured_js``,
``gripper/measured_js``, ``operating_state`` and ``error``; and its buttons as
``/footpedals/clutch``, ``camera``, ``operator_present``. If the device is unplugged, only the state
is repeated, and a clutch pedal that fails to pressed.

Parameters: ``~leader`` (gamepad; name or path of a ``.py`` file), ``~settings`` (of its class, a
dictionary), ``~rate`` [Hz] (200: public clients read data that are at most 20 ms old), ``~pedals``
(true: its buttons are pedals).
Exit code 0: ended by the user; 1: the device is not there or must not be read; 2: a parameter that
must not be used.
"""

from __future__ import annotations

import math
import signal
import sys
import time
from dataclasses import dataclass
from typing import Any

import rospy
from sensor_msgs.msg import Joy
from std_msgs.msg import String

from crtk_msgs.msg import OperatingState
from surg_core.hand.leader_sample import LeaderSample
from surg_ros.leader_port import LeaderTopics, joy_message
from surg_ros.master_check import master_is_online
from surg_ros.params import ParamError, dictionary, flag, read, real, text
from surg_teleop.leaders.evdev.device_leader import InputLeader
from surg_teleop.leaders.leader import Leader, LeaderError, load, names

RATES = (20.0, 500.0)
"""[Hz] Slower than 10 Hz would read as silence."""
STATE_PERIOD = 0.1
"""[s] Longest interval between two messages on operating_state."""
PEDAL_PERIOD = 0.05
"""[s] The same of pedals, which expire after `contract.PRESENCE_TIMEOUT`."""
PEDALS = {"clutch": "clutch", "camera": "camera", "present": "operator_present"}
"""Buttons of a leader that are pedals, and their topics."""


class LeaderNode:
    """Reads an open leader and publishes what it reads; with ``pedals`` its buttons are pedals."""

    def __init__(self, leader: Leader, pedals: bool) -> None:
        self._leader = leader
        self._device = leader if isinstance(leader, InputLeader) else None
        name = leader.name
        self._samples = LeaderTopics(name)
        keys: dict[str, Any] = {"queue_size": 1, "tcp_nodelay": True}
        self._joy = rospy.Publisher(f"/{name}/joy", Joy, **keys)
        self._state = rospy.Publisher(
            f"/{name}/operating_state", OperatingState, latch=True, **keys
        )
        self._error = rospy.Publisher(f"/{name}/error", String, latch=True, **keys)
        self._has_pedals = pedals
        self._pedals: dict[str, rospy.Publisher] = {}
        self._problem = ""
        self._published: dict[str, tuple[object, float]] = {}

    def tick(self, now: float) -> None:
        """Read and publish once; now is the steady clock [s]."""
        problem = ""
        sample: LeaderSample | None = None
        try:
            sample = self._leader.read(now)
        except LeaderError as error:
            problem = str(error)
        stamp = rospy.Time.now()
        if sample is not None:
            problem = sample.problem
            if not problem:
                self._samples.publish(sample, stamp)
            if self._has_pedals:
                self._publish_pedals(sample.buttons, now, stamp)
        elif self._device is not None:
            problem = problem or self._device.lost
        self._publish_joy(now, stamp)
        self._publish_problem(problem)
        state = "FAULT" if problem else "DISABLED" if sample is None else "ENABLED"
        if self._due("state", state, now, STATE_PERIOD):
            message = OperatingState(state=state, is_homed=state == "ENABLED")
            message.header.stamp = stamp
            self._state.publish(message)

    def _publish_joy(self, now: float, stamp: rospy.Time) -> None:
        joy = self._device.joy(now) if self._device is not None else None
        if self._device is None or joy is None:
            return
        if self._due("joy", joy, now, 1.0 / self._device.layout.autorepeat):
            self._joy.publish(joy_message(joy.buttons, stamp, joy.axes))

    def _publish_pedals(self, buttons: frozenset[str], now: float, stamp: rospy.Time) -> None:
        """Only pedals that this leader has: another leader may have the others."""
        pressed = buttons & PEDALS.keys()
        if not self._due("pedals", pressed, now, PEDAL_PERIOD):
            return
        own = set(pressed)
        if self._device is not None:
            layout = self._device.layout
            own |= layout.actions.keys() & PEDALS.keys()
            own |= {"present"} if layout.dead_man is not None else set()
        for name in own - self._pedals.keys():
            self._pedals[name] = rospy.Publisher(
                f"/footpedals/{PEDALS[name]}", Joy, queue_size=10, tcp_nodelay=True, latch=True
            )
        for name, publisher in self._pedals.items():
            publisher.publish(joy_message([name in buttons], stamp))

    def _publish_problem(self, problem: str) -> None:
        if problem and problem != self._problem:
            print(f"leader: {problem}", file=sys.stderr, flush=True)
            self._error.publish(problem)
        elif self._problem and not problem:
            print(f"leader: {self._leader.name} is back; engage anew", flush=True)
        self._problem = problem

    def _due(self, topic: str, value: object, now: float, period: float) -> bool:
        """Whether a value has changed, or was published longer ago than a period [s]."""
        before, when = self._published.get(topic, (None, -math.inf))
        if value == before and now - when < period:
            return False
        self._published[topic] = (value, now)
        return True


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    leader: str = text("gamepad")
    settings: dict[str, Any] = dictionary()
    rate: float = real(*RATES, 200.0)
    pedals: bool = flag(True)


def main() -> int:
    """Run the node; returns the exit code."""
    if not master_is_online("leader"):
        return 1
    rospy.init_node("leader", disable_signals=True)
    # Every way out but kill -9 goes through `finally`: a grabbed device must be given back.
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(name, lambda *_: sys.exit(0))
    try:
        given = read(Parameters, rospy.get_param("~", {}))
        leader = load(given.leader, given.settings)
    except (ParamError, LeaderError) as error:
        print(f"leader: {error}\nleader: there are {', '.join(names())}", file=sys.stderr)
        return 2
    try:
        leader.open()
        run(LeaderNode(leader, given.pedals), given.rate)
    except LeaderError as error:
        print(f"leader: {error}", file=sys.stderr)
        return 1
    finally:
        leader.close()
        rospy.signal_shutdown("ended")
    return 0


def run(node: LeaderNode, rate: float) -> None:
    """Tick until ROS ends; lost time is not made up for."""
    while not rospy.is_shutdown():
        started = time.monotonic()
        node.tick(started)
        time.sleep(max(0.0, started + 1.0 / rate - time.monotonic()))
