"""Any leader as a process of its own, on topics: what ROS's ``joy`` does, and CRTK.

Publishes, as far as the leader has it: ``/<name>/joy`` (sensor_msgs/Joy: on every change, and again
at the layout's autorepeat), ``/<name>/measured_cp`` and ``/<name>/measured_cv`` in the view frame,
``/<name>/spherical/measured_js`` for one that turns the shaft about the trocar,
``/<name>/gripper/measured_js``, ``/<name>/operating_state``, ``/<name>/error``, and its buttons as
``/footpedals/clutch``, ``camera``, ``operator_present``. A device that has gone is silence: nothing
is repeated but its state, and a clutch pedal that fails to pressed.

Parameters: ``~leader`` (gamepad; name or path of a ``.py`` file), ``~settings`` (of its class, a
dictionary), ``~rate`` [Hz] (100), ``~pedals`` (true: its buttons are pedals).
Exit code 0: ended by the user; 1: the device is not there or must not be read; 2: a parameter that
must not be used.
"""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import dataclass
from typing import Any

import rosgraph
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState, Joy
from std_msgs.msg import String

from crtk_msgs.msg import OperatingState
from surg_core import matrix_to_quaternion_xyzw
from surg_ros.params import ParamError, dictionary, flag, read, real, text
from surg_teleop.leaders.bundled.keyboard import HELP, Keyboard
from surg_teleop.leaders.crtk_leader_node import JOINTS
from surg_teleop.leaders.evdev.device_leader import InputLeader
from surg_teleop.leaders.leader import (
    HandlePose,
    HandRate,
    Leader,
    LeaderError,
    LeaderSample,
    load,
    names,
)

RATES = (20.0, 500.0)
"""[Hz] Slower than 10 Hz would read as silence."""
STATE_EVERY = 0.1
"""[s] operating_state at least that often."""
PEDALS_EVERY = 0.05
"""[s] Pedals repeat at least that often; they expire after `contract.PRESENCE_TIMEOUT`."""
GRIPPER_OPEN = 1.0
"""[rad] What a jaw that is fully open says on gripper/measured_js; closed is 0."""
PEDALS = {"clutch": "clutch", "camera": "camera", "present": "operator_present"}
"""Buttons of a leader that are pedals, and their topics."""


class LeaderNode:
    """Reads one leader and says what it reads."""

    def __init__(self, leader: Leader, pedals: bool) -> None:
        """Advertises; reads nothing."""
        self._leader = leader
        self._out = {
            topic: rospy.Publisher(
                f"/{leader.name}/{topic}", kind, queue_size=1, tcp_nodelay=True, latch=latch
            )
            for topic, kind, latch in (
                ("measured_cp", PoseStamped, False),
                ("measured_cv", TwistStamped, False),
                ("spherical/measured_js", JointState, False),
                ("gripper/measured_js", JointState, False),
                ("joy", Joy, False),
                ("operating_state", OperatingState, True),
                ("error", String, True),
            )
        }
        self._pedals: dict[str, rospy.Publisher] = {}
        self._said_pedals: dict[str, bool] = {}
        self._says_pedals = pedals
        self._problem = ""
        self._said: dict[str, tuple[object, float]] = {
            "state": ("", -1.0),
            "joy": (None, -1.0),
            "pedals": (None, -1.0),
        }

    def tick(self, now: float) -> None:
        """Reads once and publishes; now is the steady clock [s]."""
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
                self._say_sample(sample, stamp)
            self._say_pedals(sample.buttons, now, stamp)
        elif isinstance(self._leader, InputLeader):
            problem = problem or self._leader.lost
        self._say_joy(now, stamp)
        self._say_problem(problem)
        alive = sample is not None and not problem
        self._say_state("FAULT" if problem else "ENABLED" if alive else "DISABLED", now, stamp)

    def _say_sample(self, sample: LeaderSample, stamp: rospy.Time) -> None:
        if sample.pose is not None:
            self._out["measured_cp"].publish(pose_message(sample.pose, stamp))
        if sample.rate is not None and sample.rate.spherical is not None:
            self._out["spherical/measured_js"].publish(spherical_message(sample.rate, stamp))
        elif sample.rate is not None:
            self._out["measured_cv"].publish(rate_message(sample.rate, stamp))
        if sample.grip is not None:
            joint = JointState(name=["gripper"], position=[GRIPPER_OPEN * sample.grip])
            joint.header.stamp = stamp
            self._out["gripper/measured_js"].publish(joint)

    def _say_joy(self, now: float, stamp: rospy.Time) -> None:
        if not isinstance(self._leader, InputLeader):
            return
        joy = self._leader.joy(now)
        if joy is not None and self._due("joy", joy, now, 1.0 / self._leader.layout.autorepeat):
            message = Joy(axes=list(joy.axes), buttons=list(joy.buttons))
            message.header.stamp = stamp
            self._out["joy"].publish(message)

    def _say_pedals(self, buttons: frozenset[str], now: float, stamp: rospy.Time) -> None:
        """Only pedals that this leader has pressed once: another leader may have the others."""
        if not self._says_pedals:
            return
        pressed = tuple(sorted(buttons & PEDALS.keys()))
        if not self._due("pedals", pressed, now, PEDALS_EVERY):
            return
        has = set(pressed)
        if isinstance(self._leader, InputLeader):
            layout = self._leader.layout
            has |= layout.actions.keys() & PEDALS.keys()
            has |= {"present"} if layout.dead_man is not None else set()
        for name in has - self._pedals.keys():
            self._pedals[name] = rospy.Publisher(
                f"/footpedals/{PEDALS[name]}", Joy, queue_size=10, tcp_nodelay=True, latch=True
            )
        for name, publisher in self._pedals.items():
            message = Joy(buttons=[int(name in buttons)])
            message.header.stamp = stamp
            publisher.publish(message)

    def _say_state(self, state: str, now: float, stamp: rospy.Time) -> None:
        if self._due("state", state, now, STATE_EVERY):
            message = OperatingState(state=state, is_homed=state == "ENABLED")
            message.header.stamp = stamp
            self._out["operating_state"].publish(message)

    def _say_problem(self, problem: str) -> None:
        if problem and problem != self._problem:
            print(f"leader: {problem}", file=sys.stderr, flush=True)
            self._out["error"].publish(problem)
        elif self._problem and not problem:
            print(f"leader: {self._leader.name} is back; engage anew", flush=True)
        self._problem = problem

    def _due(self, what: str, value: object, now: float, every: float) -> bool:
        """Whether something has changed, or was said longer ago than every [s]."""
        said, when = self._said[what]
        if value == said and now - when < every:
            return False
        self._said[what] = (value, now)
        return True


def pose_message(pose: HandlePose, stamp: rospy.Time) -> PoseStamped:
    """A handle's pose in V."""
    message = PoseStamped()
    message.header.stamp = stamp
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = pose.p_VH.tolist()
    q = matrix_to_quaternion_xyzw(pose.R_VH).tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = q
    return message


def rate_message(rate: HandRate, stamp: rospy.Time) -> TwistStamped:
    """A hand's rate in V; the roll is the angular velocity about z."""
    message = TwistStamped()
    message.header.stamp = stamp
    linear = message.twist.linear
    linear.x, linear.y, linear.z = rate.v_V.tolist()
    message.twist.angular.z = rate.roll
    return message


def spherical_message(rate: HandRate, stamp: rospy.Time) -> JointState:
    """A hand's rates about the trocar: yaw, pitch [rad/s], insertion [m/s], roll [rad/s]."""
    assert rate.spherical is not None
    message = JointState(name=list(JOINTS), velocity=[*rate.spherical.tolist(), rate.roll])
    message.header.stamp = stamp
    return message


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    leader: str = text("gamepad")
    settings: dict[str, Any] = dictionary()
    rate: float = real(*RATES, 100.0)
    pedals: bool = flag(True)


def main() -> int:
    """Run the node; returns the exit code."""
    if not rosgraph.is_master_online():
        print(
            f"leader: no ROS master at {rosgraph.get_master_uri()}; start one with 'rosmaster "
            "--core' or './surg up CELL'",
            file=sys.stderr,
        )
        return 1
    rospy.init_node("leader", disable_signals=True)
    # Every way out but kill -9 goes through `finally`: a terminal must be given back.
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(name, lambda *_: sys.exit(0))
    try:
        given = read(Parameters, rospy.get_param("~", {}))
        leader = load(given.leader, given.settings)
    except (ParamError, LeaderError) as error:
        print(f"leader: {error}\nleader: there are {', '.join(names())}", file=sys.stderr)
        return 2
    if isinstance(leader, Keyboard):
        signal.signal(signal.SIGTSTP, signal.SIG_IGN)  # a stopped process would keep the terminal
        print(HELP, end="", flush=True)
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
    """Ticks until ROS ends. What came late is not made up for."""
    while not rospy.is_shutdown():
        started = time.monotonic()
        node.tick(started)
        time.sleep(max(0.0, started + 1.0 / rate - time.monotonic()))
