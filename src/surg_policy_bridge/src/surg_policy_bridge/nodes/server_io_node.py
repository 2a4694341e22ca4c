"""What both loops of the model server share: socket, cycles, commands, and the lock."""

from __future__ import annotations

import os
import threading
import time

import rospy
import zmq
from sensor_msgs.msg import Joy

import surg_core
from surg_core.arm_view import ArmCommands, ArmView
from surg_core.contract import SECOND_NS, TICK_NS
from surg_core.status_check import LatestStatus, fault
from surg_msgs.msg import Cycle, DriftStatus, TeleopStatus
from surg_policy_bridge.nodes.observation_sources_node import ObservationSources
from surg_policy_bridge.nodes.policy_topics_node import PolicyTopics
from surg_policy_bridge.nodes.router_node import Router
from surg_policy_bridge.server import operator_first
from surg_policy_bridge.server.model_server import ModelServer, ServerSettings
from surg_policy_bridge.server.safety_controller import SafetyController
from surg_policy_bridge.server.server_parameters import Settings
from surg_policy_bridge.server.sessions import new_number
from surg_policy_bridge.server.stop_reason import StopReason
from surg_policy_bridge.server.timers import SILENCE, OperatorPresence
from surg_policy_bridge.server.wire_endpoint import WireEndpoint
from surg_policy_client.keys import ServerKeys
from surg_ros.arm_port import ArmPort, arm_view

COMMANDS = ("state_command", "authority/claim", "hold", "jaw/servo_jp", "servo_cp")
"""Topics of an arm that the server publishes."""


class ServerIO:
    """Socket and topics of a `ModelServer`, which makes every decision.

    Args:
        settings: The node's parameters.
        cell: The cell.
        keys: Of the server; None: this machine only.

    Attributes:
        lock: Held by every callback, and by the loop whenever it does not wait.
        finished: Set to end the node.
        cycles: By arm: receipt on the steady clock [ns] and newest control cycle.
    """

    def __init__(self, settings: Settings, cell: surg_core.Cell, keys: ServerKeys | None) -> None:
        self.settings = settings
        self.lock = threading.RLock()
        self.finished = threading.Event()
        self.server = _model_server(settings, cell)
        self.sources = ObservationSources(settings, cell)
        self.cycles: dict[str, tuple[int, Cycle]] = {}
        self._router = Router(settings.bind, keys)
        self._endpoint = WireEndpoint(self.server)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK)  # type: ignore[attr-defined]
        self._poller = zmq.Poller()
        self._poller.register(self._router.socket, zmq.POLLIN)
        self._poller.register(self._wake, zmq.POLLIN)
        self._teleop = LatestStatus("/teleop/status")
        self._presence = OperatorPresence()
        self._moved = ""
        self.ports = {name: ArmPort(name, COMMANDS) for name in settings.arms}
        self.topics = PolicyTopics(settings.bind)

    @property
    def over(self) -> bool:
        """Whether the node ends."""
        return self.finished.is_set() or bool(rospy.is_shutdown())

    def rouse(self) -> None:
        """End the loop's wait."""
        os.eventfd_write(self._wake, 1)  # type: ignore[attr-defined]

    def wait(self, longest_ms: int) -> None:
        """Wait for a message of a policy, or `rouse`; without the lock, which callbacks need."""
        if self._wake in dict(self._poller.poll(longest_ms)):
            os.eventfd_read(self._wake)  # type: ignore[attr-defined]

    def listen(self) -> None:
        """Receive all messages and reply."""
        for peer, parts in self._router.receive():
            self._endpoint.receive(peer, parts, time.monotonic_ns())
        self.reply()

    def reply(self) -> None:
        """Send the replies of the server."""
        for peer, parts in self._endpoint.take_frames():
            self._router.send(peer, parts)

    def views(self, since: int = 0) -> dict[str, ArmView]:
        """The arms heard since a time on the steady clock [ns], by name."""
        return {arm: arm_view(cycle) for arm, (at, cycle) in self.cycles.items() if at >= since}

    def send(self, commands: dict[str, ArmCommands], views: dict[str, ArmView]) -> None:
        """Send commands, stamped for the cycle after the one that they answer."""
        for arm, command in commands.items():
            answered = views[arm].stamp_ns if arm in views else 0
            command.stamp_ns = answered + TICK_NS if answered else 0
            self.ports[arm].send(command)

    def on_teleop(self, message: TeleopStatus) -> None:
        """The state of the operator's hands has come."""
        with self.lock:
            self._teleop.take(message, time.monotonic())
            self.rouse()

    def on_drift(self, message: DriftStatus) -> None:
        """Whether the pictures are what was calibrated; once they are not, they stay so."""
        if message.refusal and not fault(message):
            with self.lock:
                self._moved = message.refusal
                self.rouse()

    def on_present(self, message: Joy, source: str) -> None:
        """A pedal or page reports whether the operator is there."""
        with self.lock:
            down = bool(message.buttons) and message.buttons[0] == 1
            self._presence.press(source, down, time.monotonic_ns())
            self.rouse()

    def refusal(self) -> operator_first.Refusal:
        """Why the policy may not have the arms now."""
        settings, now = self.settings, time.monotonic()
        present = not settings.need_present or self._presence.detected(time.monotonic_ns())
        refusal = operator_first.refusal(
            settings.arms, self._teleop, now, settings.need_teleop, present, self._moved
        )
        if refusal[0] is StopReason.TELEOP_STATUS and (complaint := self._teleop.complaint(now)):
            rospy.logwarn("no arm is given to a policy: %s", complaint)
        return refusal

    def close(self) -> None:
        """Close the socket."""
        self._router.close()


def _model_server(settings: Settings, cell: surg_core.Cell) -> ModelServer:
    arms = {name: cell.arms[name] for name in settings.arms}
    answer = round(settings.answer_timeout * SECOND_NS)
    return ModelServer(
        ServerSettings(
            arms=settings.arms,
            node=rospy.get_name(),
            instruction=settings.instruction,
            autostart=settings.autostart,
            silence=answer if settings.lockstep else SILENCE,
        ),
        SafetyController(arms, settings.clip),
        new_number,
    )
