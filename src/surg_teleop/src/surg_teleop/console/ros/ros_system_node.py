"""The robot's side of the console on ROS topics: what it hears, and orders as messages.

Fast topics are fetched as bytes, and read, only when somebody wants to know: a figure for people at
20 Hz must not cost the processor what a control loop costs.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState, Joy
from std_msgs.msg import Bool, Float64, String

import surg_core
from crtk_msgs.msg import OperatingState, StringStamped
from surg_core.contract import STATE_NAMES
from surg_core.status_check import Newest, value_name
from surg_msgs.msg import (
    Cycle,
    HandStatus,
    PolicyStatus,
    RecordStatus,
    SimStatus,
    TeleopStatus,
)
from surg_ros.transport.polled_subscriber import PolledSubscriber
from surg_teleop.console.session import operator_messages
from surg_teleop.console.session.console_orders import (
    Camera,
    Clutch,
    Follow,
    Move,
    Order,
    OtherMapping,
    Policy,
    Present,
    PutBack,
    Record,
    SetScale,
    StateCommand,
)
from surg_teleop.console.session.episode_list import Entry, Episodes
from surg_teleop.console.session.page_status import finite
from surg_teleop.console.session.system_state import (
    Arm,
    Follower,
    Gauges,
    PolicyServer,
    Recorder,
    Robot,
    SimTask,
)
from surg_teleop.console.web.page_protocol import Input

FRESH = 1.0
"""[s] for which a figure is shown."""
REPEAT = 0.05
"""[s] What is held down is said again that often: the teleoperation notices when it is not."""
FAST = {
    "rcm": "rcm/error",
    "joints": "measured_js",
    "trocar": "trocar/measured_cf",
    "tip": "tool/measured_cf",
}
"""Topics of the driven arm with a figure in each message."""
REASONS = {int(reason): reason for reason in surg_core.Reason.__members__.values()}


class RosSystem:
    """See `server.System`.

    Args:
        arms: CRTK names, the driven one first.
        leader: Namespace of the leader's topics; empty: the page is no leader.
        teleop: Name of the teleoperation node.
        episodes: The recorder's folder; None: nothing is listed.
    """

    def __init__(
        self, arms: tuple[str, ...], leader: str, teleop: str, episodes: Path | None
    ) -> None:
        self._lock = threading.Lock()
        self._arms = {name: Arm(name) for name in arms}
        self._statuses = {
            topic: Newest(topic)
            for topic in (f"/{teleop}/status", "/record/status", "/sim/status", "/policy/status")
        }
        self._teleop = f"/{teleop}/status"
        self._newest: dict[str, tuple[float, bytes]] = {}
        self._peak = 0.0
        self._episodes = None if episodes is None else Episodes(episodes)
        self._leader = leader
        self._held: dict[str, bool] = {}
        self._repeated = -1e9
        self._out = _publishers(arms, leader)
        self._fast = {
            what: PolledSubscriber(f"/{arms[0]}/{topic}", rospy.AnyMsg)
            for what, topic in FAST.items()
        }
        self._cycles = {arm: PolledSubscriber(f"/{arm}/cycle", Cycle) for arm in arms}
        self._subscribers = self._subscribe(arms)

    # --- what it hears ------------------------------------------------------------------------

    def _subscribe(self, arms: tuple[str, ...]) -> list[rospy.Subscriber]:
        def on(topic: str, kind: type, call: Any, *about: Any) -> rospy.Subscriber:
            keys = {"queue_size": 10, "tcp_nodelay": True}
            return rospy.Subscriber(topic, kind, lambda message: call(message, *about), **keys)

        found = [
            on(self._teleop, TeleopStatus, self._on_status, self._teleop),
            on("/record/status", RecordStatus, self._on_status, "/record/status"),
            on("/sim/status", SimStatus, self._on_status, "/sim/status"),
            on("/policy/status", PolicyStatus, self._on_status, "/policy/status"),
        ]
        for arm in arms:
            found.append(on(f"/{arm}/operating_state", OperatingState, self._on_state, arm))
            found.append(on(f"/{arm}/warning", String, self._on_warning, arm))
        return found

    def _hear_fast(self, now: float) -> None:
        """What has come on the fast topics since the last time; with the lock held."""
        for what, polled in self._fast.items():
            messages = polled.fetch()
            if messages:
                self._newest[what] = (now, messages[-1])
            if what == "rcm":
                values = (_last_double(data) for data in messages)
                self._peak = max([self._peak, *(value for value in values if value is not None)])

    def _on_state(self, message: OperatingState, arm: str) -> None:
        with self._lock:
            before = self._arms[arm]
            self._arms[arm] = replace(
                before,
                state=message.state,
                homed=message.is_homed,
                heard=time.monotonic(),
                reason=before.reason if message.state == before.state else None,
            )

    def _on_warning(self, message: String, arm: str) -> None:
        with self._lock:
            self._arms[arm] = replace(
                self._arms[arm],
                warning=operator_messages.without_name(message.data, arm),
                warned=time.monotonic(),
            )

    def _on_status(self, message: Any, topic: str) -> None:
        with self._lock:
            now = time.monotonic()
            self._statuses[topic].take(message, now)
            if complaint := self._statuses[topic].complaint(now):
                rospy.logwarn("console: %s", complaint)

    def _hear_reasons(self) -> None:
        """Keep why each arm is in its state; with the lock held."""
        for name, polled in self._cycles.items():
            messages = polled.fetch()
            if not messages:
                continue
            state, reason = state_and_reason(messages[-1])
            if state == self._arms[name].state:
                self._arms[name] = replace(self._arms[name], reason=reason)

    def robot(self) -> Robot:
        """See `server.System`."""
        now = time.monotonic()
        with self._lock:
            self._hear_fast(now)
            self._hear_reasons()
            newest = {
                what: data for what, (heard, data) in self._newest.items() if now - heard < FRESH
            }
            hands = self._hands(now)
            first, others = hands[0], hands[1:]
            own = [hand for hand in others if hand.leader == first.leader]
            record, sim = self._at("/record/status", now), self._at("/sim/status", now)
            policy = self._at("/policy/status", now)
            return Robot(
                tuple(self._arms.values()),
                first,
                own[0] if own else Follower(),
                tuple(hand for hand in others if hand.leader != first.leader),
                Gauges(
                    rcm=_last_double(newest.get("rcm")),
                    rcm_peak=self._peak if "rcm" in newest else None,
                    depth=depth(newest.get("joints")),
                    trocar=force(newest.get("trocar")),
                    tip=force(newest.get("tip")),
                ),
                _recorder(record) if record else Recorder(),
                simulated=sim is not None,
                task=_task(sim) if sim else SimTask(),
                policy=_policy(policy) if policy else PolicyServer(),
            )

    def _at(self, topic: str, now: float) -> Any:
        """The status of a topic; None: there is none that may be acted on."""
        return self._statuses[topic].at(now)

    def _hands(self, now: float) -> list[Follower]:
        """What the teleoperation states of each hand; one empty one: nothing valid."""
        status = self._at(self._teleop, now)
        if status is None or not status.hands:
            return [Follower()]
        first, *others = map(_follower, status.hands)
        return [replace(first, reason=first.reason or status.picture), *others]

    def told(self) -> None:
        """The pages have been told: the peak starts anew."""
        with self._lock:
            self._peak = 0.0

    def entries(self) -> list[Entry]:
        """See `server.System`."""
        return [] if self._episodes is None else self._episodes.entries()

    # --- what it says -------------------------------------------------------------------------

    def obey(self, orders: list[Order]) -> None:
        """See `server.System`."""
        for order in orders:
            self._send(order)

    def _send(self, order: Order) -> None:
        out = self._out
        if isinstance(order, Move):
            self._move(order.sample)
        elif isinstance(order, Present):
            self._hold("/console/operator_present", order.on)
        elif isinstance(order, Follow):
            out["/console/teleop/enable"].publish(order.on)
        elif isinstance(order, Clutch):
            self._hold("/console/clutch", order.on)
        elif isinstance(order, Camera):
            self._hold("/console/camera", order.on)
        elif isinstance(order, OtherMapping):
            out["/console/rate"].publish(_joy(True))
            rospy.Timer(
                rospy.Duration.from_sec(0.06),
                lambda event: out["/console/rate"].publish(_joy(False)),
                oneshot=True,
            )
        elif isinstance(order, SetScale):
            out["/console/teleop/set_scale"].publish(order.value)
        elif isinstance(order, Record):
            out["/record/record"].publish(order.on)
        elif isinstance(order, PutBack):
            out["/sim/by_hand"].publish(order.arm)
        elif isinstance(order, Policy):
            out["/policy/enable"].publish(order.on)
        elif isinstance(order, StateCommand):
            message = StringStamped(string=order.word)
            message.header.stamp = rospy.Time.now()
            out[f"/{order.arm}/state_command"].publish(message)

    def _hold(self, topic: str, on: bool) -> None:
        self._held[topic] = on
        self._out[topic].publish(_joy(on))

    def live(self) -> None:
        """See `server.System`."""
        now = time.monotonic()
        if now - self._repeated >= REPEAT:
            self._repeated = now
            for topic, on in self._held.items():
                self._out[topic].publish(_joy(on))

    def _move(self, sample: Input) -> None:
        stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
        if sample.hand == "position":
            pose = PoseStamped()
            pose.header.stamp = stamp
            p, q = pose.pose.position, pose.pose.orientation
            p.x, p.y, p.z = sample.p
            q.z, q.w = half_turn(sample.roll)
            self._out["measured_cp"].publish(pose)
        else:
            twist = TwistStamped()
            twist.header.stamp = stamp
            v = twist.twist.linear
            v.x, v.y, v.z = sample.v
            twist.twist.angular.z = sample.roll_rate
            self._out["measured_cv"].publish(twist)
        if sample.grip is not None:
            grip = JointState(name=["gripper"], position=[sample.grip])
            grip.header.stamp = stamp
            self._out["gripper"].publish(grip)


def _publishers(arms: tuple[str, ...], leader: str) -> dict[str, rospy.Publisher]:
    def publisher(topic: str, kind: type, queue: int = 10) -> rospy.Publisher:
        return rospy.Publisher(topic, kind, queue_size=queue, tcp_nodelay=True)

    found = {
        "/record/record": publisher("/record/record", Bool),
        "/policy/enable": publisher("/policy/enable", Bool),
        "/sim/by_hand": publisher("/sim/by_hand", String),
        "/console/teleop/enable": publisher("/console/teleop/enable", Bool),
        "/console/teleop/set_scale": publisher("/console/teleop/set_scale", Float64),
    }
    if leader:
        found["measured_cp"] = publisher(f"/{leader}/measured_cp", PoseStamped, 1)
        found["measured_cv"] = publisher(f"/{leader}/measured_cv", TwistStamped, 1)
        found["gripper"] = publisher(f"/{leader}/gripper/measured_js", JointState, 1)
    for name in ("operator_present", "clutch", "camera", "rate"):
        found[f"/console/{name}"] = publisher(f"/console/{name}", Joy)
    for arm in arms:
        found[f"/{arm}/state_command"] = publisher(f"/{arm}/state_command", StringStamped)
    return found


def _follower(hand: HandStatus) -> Follower:
    return Follower(
        state=value_name(hand, "state"),
        mapping=value_name(hand, "mapping").lower(),
        reason=hand.detail,
        scale=finite(hand.scale),
        leader=hand.leader,
        arm=hand.arm,
    )


def _recorder(status: RecordStatus) -> Recorder:
    return Recorder(value_name(status, "state"), status.detail)


def _task(status: SimStatus) -> SimTask:
    task = status.task
    return SimTask(value_name(task, "state"), task.name, task.phase, task.detail)


def _policy(status: PolicyStatus) -> PolicyServer:
    name = status.policy
    return PolicyServer(value_name(status, "state"), name, status.detail, status.refused)


def state_and_reason(data: bytes) -> tuple[str, surg_core.Reason | None]:
    """Operating state and reason in a surg_msgs/Cycle; empty and None: unknown."""
    try:  # header with its frame, tick, state, homed, busy, reason_code
        (frame,) = struct.unpack_from("<I", data, 12)
        state, _, _, reason = struct.unpack_from("<4B", data, 24 + frame)
    except struct.error:
        return "", None
    return dict(enumerate(STATE_NAMES)).get(state, ""), REASONS.get(reason)


def half_turn(angle: float) -> tuple[float, float]:
    """Z and w of the quaternion of a rotation about z."""
    return math.sin(angle / 2.0), math.cos(angle / 2.0)


def _joy(on: bool) -> Joy:
    message = Joy(buttons=[int(on)])
    message.header.stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
    return message


def _last_double(data: bytes | None) -> float | None:
    """A surg_msgs/ScalarStamped ends with its number."""
    if data is None or len(data) < 8:
        return None
    return float(struct.unpack_from("<d", data, len(data) - 8)[0])


def depth(data: bytes | None) -> float | None:
    """Third of the four virtual joints in a sensor_msgs/JointState [m]; None: it says none."""
    if data is None:
        return None
    try:  # header with its frame, names, positions; each with its length in front
        (frame,) = struct.unpack_from("<I", data, 12)
        (names,) = struct.unpack_from("<I", data, 16 + frame)
        at = 20 + frame
        for _ in range(names):
            (length,) = struct.unpack_from("<I", data, at)
            at += 4 + length
        (count,) = struct.unpack_from("<I", data, at)
        found = struct.unpack_from("<4d", data, at + 4)[2] if count == 4 else None
    except struct.error:
        return None
    return found


def force(data: bytes | None) -> float | None:
    """Length of the force in a geometry_msgs/WrenchStamped [N]; None: it says none."""
    if data is None:
        return None
    try:  # header with its frame, then the force
        (frame,) = struct.unpack_from("<I", data, 12)
        x, y, z = struct.unpack_from("<3d", data, 16 + frame)
    except struct.error:
        return None
    return math.hypot(x, y, z)
