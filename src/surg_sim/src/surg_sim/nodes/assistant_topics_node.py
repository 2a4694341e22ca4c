"""The bridge's topics of the assistant's instrument, and the commands that wait for their tick."""

from __future__ import annotations

import struct
import time
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from surg_core.contract import SECOND_NS, VIRTUAL_JOINTS
from surg_msgs.msg import ReceivedCommand
from surg_ros import link_messages
from surg_ros.byte_topics import BytesPublisher, as_bytes
from surg_sim.nodes.command_echo import CommandEcho
from surg_sim.physics.assistant_arm import AssistantCommand

if TYPE_CHECKING:
    from surg_sim.nodes.sim_bridge_node import Bridge


class AssistantTopics:
    """The assistant's instrument: what it measures, and the commands that wait for their tick.

    In lock-step a participant's command carries the stamp of the tick it is for: it may come before
    the tick in front of it is executed. Anybody else's is obeyed at once; in free-run what is late,
    because a network held it up, is not.
    """

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        # Tick, sender, what, value; in free-run put in without a lock (see command_box.py).
        self._waiting: deque[tuple[int, str, str, Any]] = deque()
        self._state = BytesPublisher("/assistant/measured_js", JointState, bridge.lockstep)
        self._jaw = BytesPublisher("/assistant/jaw/measured_js", JointState, bridge.lockstep)
        self._layout = link_messages.JointStateLayout(VIRTUAL_JOINTS)
        self._jaw_layout = link_messages.JointStateLayout(["jaw"])
        self._command_echo = CommandEcho()
        self._received = rospy.Publisher(
            "/assistant/received", ReceivedCommand, queue_size=0 if bridge.lockstep else 500
        )

        def listen(topic: str, what: str, size: int) -> Any:
            def callback(message: Any) -> None:
                caller = str(message._connection_header.get("callerid", ""))
                if self._received.get_num_connections():
                    now = Header(stamp=rospy.Time(*divmod(time.time_ns(), SECOND_NS)))
                    said = ReceivedCommand(now, topic, caller, JointState._type, message.data)
                    self._received.publish(said)
                sender = caller.lstrip("/")
                try:
                    stamp_ns, position, _ = link_messages.unpack_joint_state(message.data)
                    if len(position) != size or not np.isfinite(position).all():
                        raise ValueError(f"{position}, allowed: {size} finite numbers")
                    if not bridge.lockstep and self._command_echo.is_late(stamp_ns):
                        raise ValueError(
                            "late: it answers a state of more than 0.1 s ago; not obeyed"
                        )
                except (struct.error, ValueError) as error:
                    rospy.logwarn_throttle(1.0, f"/assistant/{topic} from {sender}: {error}")
                    position, stamp_ns = None, 0
                bridge.on_assistant(self, sender, stamp_ns, what, position)

            return rospy.Subscriber(
                f"/assistant/{topic}", as_bytes(JointState), callback, tcp_nodelay=True
            )

        self._inputs = [listen("servo_jp", "joints", 4), listen("jaw/servo_jp", "jaw", 1)]

    def keep(self, tick: int, sender: str, what: str, value: Any) -> None:
        """A command for a tick; 0: for the next one."""
        self._waiting.append((tick, sender, what, value))

    def take(self, tick: int) -> AssistantCommand | None:
        """What is for this tick: of each kind the newest, whatever the order of arrival was."""
        here = [self._waiting.popleft() for _ in range(len(self._waiting))]
        self._waiting.extend(w for w in here if w[0] > tick)
        due = sorted((w for w in here if w[0] <= tick), key=lambda w: w[:2])
        if not due:
            return None
        newest = {what: value for _, _, what, value in due}
        jaw = newest.get("jaw")
        return AssistantCommand(newest.get("joints"), None if jaw is None else float(jaw[0]))

    def publish(self, tick: int, stamp_ns: int, joints: Any, jaw: float) -> None:
        """What the instrument measures."""
        self._command_echo.record(stamp_ns)
        if self._state.connections:
            self._state.send(self._layout.pack(tick, stamp_ns, joints, np.zeros(0)))
        if self._jaw.connections:
            self._jaw.send(self._jaw_layout.pack(tick, stamp_ns, np.array([jaw]), np.zeros(0)))
