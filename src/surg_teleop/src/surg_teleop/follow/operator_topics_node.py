"""What operators say on topics: pedals, enable, scale, locks and commands to one leader and arm."""

from __future__ import annotations

import threading
import time
from typing import Any

import rospy
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float64, String

from crtk_msgs.msg import StringStamped
from surg_teleop.follow.arm_switch import Hand
from surg_teleop.follow.console_topics_node import ConsoleTopics
from surg_teleop.follow.pedal_monitor import PedalMonitor
from surg_teleop.follow.teleop_status_node import TeleopStatusPublisher
from surg_teleop.follow.teleop_types import ControlMode
from surg_teleop.follow.teleoperation import Teleop

PEDALS = {"clutch": "clutch", "camera": "camera", "operator_present": "present", "rate": "rate"}
"""Buttons by topic below ``/console`` and ``/footpedals``."""


class OperatorTopics:
    """Passes the acts of operators on, under the lock; an act that starts a motion sets `wake`."""

    def __init__(
        self,
        hands: list[Hand],
        status: TeleopStatusPublisher,
        lock: threading.Lock,
        wake: threading.Event,
    ) -> None:
        self.pedals = PedalMonitor()
        self._console = ConsoleTopics(hands)
        self._hands, self._status, self._lock, self._wake = hands, status, lock, wake
        self._recording = False
        self._record = rospy.Publisher("/record/record", Bool, queue_size=2)
        teleops = []
        for hand in hands:
            for arm, teleop in hand.switch.arms.items():
                teleops.append(teleop)
                pair = f"/{hand.leader.name}_{arm}"
                listen(f"{pair}/state_command", StringStamped, self._on_state_command, teleop)
                listen(f"{pair}/set_scale", Float64, self._on_scale, [teleop])
                for name in ("lock_rotation", "lock_translation"):
                    listen(f"{pair}/{name}", Bool, self._on_lock, (teleop, name))
        for source in ("/console", "/footpedals"):
            for topic, button in PEDALS.items():
                listen(f"{source}/{topic}", Joy, self._on_pedal, (source, button))
        listen("/console/teleop/enable", Bool, self._on_enable)
        listen("/console/teleop/set_scale", Float64, self._on_scale, teleops)
        listen("/console/teleop/set_rate_control", Bool, self._on_mode, teleops)
        listen("/console/teleop/select", String, self._on_select, True)
        listen("/console/teleop/unselect", String, self._on_select, False)
        listen("/record/recording", Bool, self._on_recording)

    def switch(self, hand: Hand, on: bool) -> None:
        """Enable a leader's selected arms, or disable all of them."""
        if not on:
            hand.switch.disable()
            return
        self.pedals.forget(time.monotonic())
        for arm, teleop in hand.switch.arms.items():
            if self._console.may_enable(f"{hand.leader.name}_{arm}"):
                teleop.enable()

    def publish(self) -> None:
        """Publish what has changed."""
        self._console.publish_scale()

    def toggle_recording(self) -> None:
        """Start or stop the recorder."""
        self._record.publish(Bool(not self._recording))

    def _on_pedal(self, message: Joy, which: tuple[str, str]) -> None:
        topic_source, button = which
        with self._lock:
            # Two senders on one topic are two sources.
            source = f"{message._connection_header['callerid']} ({topic_source})"
            down = bool(message.buttons) and message.buttons[0] == 1
            changed = self.pedals.press(source, button, down, time.monotonic())
        if changed:
            self._wake.set()

    def _on_enable(self, message: Bool) -> None:
        with self._lock:
            for hand in self._hands:
                self.switch(hand, bool(message.data))
        self._wake.set()

    def _on_state_command(self, message: StringStamped, teleop: Teleop) -> None:
        with self._lock:
            if message.string == "enable":
                self.pedals.forget(time.monotonic())
                teleop.enable()
            elif message.string == "disable":
                teleop.disable()
            else:
                self._status.warn(f"state_command '{message.string}'; allowed: enable, disable")

    def _on_scale(self, message: Float64, teleops: list[Teleop]) -> None:
        with self._lock:
            for refused in {text for t in teleops if (text := t.set_scale(message.data))}:
                self._status.warn(refused)

    def _on_mode(self, message: Bool, teleops: list[Teleop]) -> None:
        with self._lock:
            for teleop in teleops:
                teleop.set_mode(ControlMode.RATE if message.data else ControlMode.POSITION)

    def _on_select(self, message: String, selected: bool) -> None:
        with self._lock:
            if refused := self._console.select(message.data, selected):
                self._status.warn(refused)

    def _on_lock(self, message: Bool, which: tuple[Teleop, str]) -> None:
        with self._lock:
            setattr(*which, bool(message.data))

    def _on_recording(self, message: Bool) -> None:
        self._recording = bool(message.data)


def listen(topic: str, kind: type, callback: Any, arguments: Any = None) -> None:
    """Subscribe without a limit of the queue and without delay."""
    rospy.Subscriber(topic, kind, callback, arguments, queue_size=None, tcp_nodelay=True)
