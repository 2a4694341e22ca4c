"""The robot's side of the console on ROS topics: what it hears, and orders as messages.

Fast topics are fetched as bytes, and read, only when somebody wants to know: a figure for people at
20 Hz must not cost the processor what a control loop costs.
"""

from __future__ import annotations

import json
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

from crtk_msgs.msg import OperatingState, StringStamped
from surg_core.contract import STATE_NAMES
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
from surg_teleop.console.session.system_state import Arm, Follower, Gauges, Robot
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
FOLLOWER_FRESH = 2.0
"""[s] for which the teleoperation's status is believed; it says it every 0.5 s."""


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
        self._because: dict[str, tuple[str, str]] = {}
        self._hands: tuple[Follower, ...] = (Follower(),)
        self._follower_heard = -1e9
        self._record: dict[str, Any] = {}
        self._sim: dict[str, Any] = {}
        self._policy: dict[str, Any] = {}
        self._policy_heard = -1e9
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
        self._subscribers = self._subscribe(arms, teleop)

    # --- what it hears ------------------------------------------------------------------------

    def _subscribe(self, arms: tuple[str, ...], teleop: str) -> list[rospy.Subscriber]:
        def on(topic: str, kind: type, call: Any, *about: Any) -> rospy.Subscriber:
            keys = {"queue_size": 10, "tcp_nodelay": True}
            return rospy.Subscriber(topic, kind, lambda message: call(message, *about), **keys)

        found = [
            on(f"/{teleop}/status", String, self._on_teleop),
            on("/record/status", String, self._on_json, "_record"),
            on("/sim/status", String, self._on_json, "_sim"),
            on("/policy/status", String, self._on_policy),
        ]
        for arm in arms:
            found.append(on(f"/{arm}/operating_state", OperatingState, self._on_state, arm))
            found.append(on(f"/{arm}/error", String, self._on_change, arm))
            found.append(on(f"/{arm}/status", String, self._on_change, arm))
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
            self._arms[arm] = replace(
                self._arms[arm],
                state=message.state,
                homed=message.is_homed,
                heard=time.monotonic(),
            )

    def _on_change(self, message: String, arm: str) -> None:
        """FAULT on `error`, every other state on `status`; either may come before the state."""
        for state in STATE_NAMES:
            why = operator_messages.reason_of(message.data, arm, state)
            if why is not None:
                with self._lock:
                    self._because[arm] = (state, why)

    def _on_warning(self, message: String, arm: str) -> None:
        with self._lock:
            self._arms[arm] = replace(
                self._arms[arm],
                warning=operator_messages.without_name(message.data, arm),
                warned=time.monotonic(),
            )

    def _on_teleop(self, message: String) -> None:
        status = _object(message.data)
        hands = status.get("hands")
        said = hands if isinstance(hands, list) else []
        found = [_follower(hand) for hand in said if isinstance(hand, dict)]
        first = found[0] if found else Follower()
        if not first.reason:
            first = replace(first, reason=str(status.get("picture") or ""))
        with self._lock:
            self._follower_heard = time.monotonic()
            self._hands = (first, *found[1:])

    def _on_json(self, message: String, name: str) -> None:
        with self._lock:
            setattr(self, name, _object(message.data))

    def _on_policy(self, message: String) -> None:
        with self._lock:
            self._policy, self._policy_heard = _object(message.data), time.monotonic()

    def robot(self) -> Robot:
        """See `server.System`."""
        now = time.monotonic()
        with self._lock:
            self._hear_fast(now)
            newest = {
                what: data for what, (heard, data) in self._newest.items() if now - heard < FRESH
            }
            alive = now - self._follower_heard < FOLLOWER_FRESH
            first, *others = self._hands if alive else (Follower(),)
            own = [hand for hand in others if hand.leader == first.leader]
            return Robot(
                tuple(map(self._with_reason, self._arms.values())),
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
                self._record,
                self._sim,
                policy=self._policy if now - self._policy_heard < FOLLOWER_FRESH else {},
            )

    def _with_reason(self, arm: Arm) -> Arm:
        state, why = self._because.get(arm.name, ("", ""))
        return replace(arm, because=why) if state == arm.state else arm

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


def _follower(hand: dict[str, Any]) -> Follower:
    """One entry of `hands` in the teleoperation's status."""
    return Follower(
        state=str(hand.get("state", "")),
        mapping=str(hand.get("mapping", "position")),
        reason=str(hand.get("message") or ""),
        scale=finite(hand.get("scale")),
        leader=str(hand.get("leader", "")),
        arm=str(hand.get("arm", "")),
    )


def half_turn(angle: float) -> tuple[float, float]:
    """Z and w of the quaternion of a rotation about z."""
    return math.sin(angle / 2.0), math.cos(angle / 2.0)


def _joy(on: bool) -> Joy:
    message = Joy(buttons=[int(on)])
    message.header.stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
    return message


def _object(text: str) -> dict[str, Any]:
    """A JSON object; empty where the text is none."""
    try:
        found = json.loads(text)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


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
