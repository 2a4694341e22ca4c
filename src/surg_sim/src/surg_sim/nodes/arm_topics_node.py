"""Topics of one simulated arm, and the commands that wait for their tick."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import JointState

import surg_core
from surg_core.contract import SECOND_NS, TICK_NS
from surg_msgs.msg import LinkStatus, PointVelocityStamped
from surg_ros import link_messages
from surg_ros.byte_topics import BytesPublisher, BytesSubscriber, as_bytes, speakers
from surg_sim.nodes.command_box import CommandBox
from surg_sim.physics.sim_arm import ArmCommand

_JAWLESS_TICKS = 5
"""In free-run an instrument without a jaw reports every 5th tick: 100 Hz."""

Arrival = tuple[int, Any, Any]
"""A command: stamp [ns], joint velocities or jaw, twist; None where it has no such part."""
Receiver = Callable[["ArmTopics", str, Arrival], None]
"""Called with the arm, ``robot`` or ``tool``, and the command."""


class ArmTopics:
    """Publishers and subscribers of one arm's robot and tool link.

    In lock-step commands are received by threads; in free-run the tick fetches them itself. The
    position of the trocar on ``rcm/track`` is ``track_stale`` old [s]; negative: not published.
    """

    def __init__(
        self, arm: surg_core.Arm, lockstep: bool, track_stale: float, receive: Receiver
    ) -> None:
        self.name: str = arm.name
        self.command = ""  # obeyed; a simulated link takes whichever comes
        self.layout = link_messages.JointStateLayout(list(arm.robot.joint_names))
        self.last_command_ns = 0
        self.said: link_messages.LinkSays | None = None  # the last status, without its stamps
        self.arrived: dict[str, CommandBox[Arrival]] = {
            link: CommandBox() for link in ("robot", "tool")
        }
        root = f"/{arm.name}"
        self.state = BytesPublisher(f"{root}/robot/measured_js", JointState, lockstep)
        self.status = BytesPublisher(f"{root}/robot/status", LinkStatus, lockstep)
        self.tool = BytesPublisher(f"{root}/tool/measured_js", JointState, lockstep)
        has_jaw = arm.instrument.jaw_min < arm.instrument.jaw_max
        wrist = arm.instrument.wrist
        self.tool_joints = ["pitch", "yaw", "jaw", "roll"] if wrist else ["jaw"]
        if wrist and not wrist.rolls:
            self.tool_joints.pop()
        self.tool_layout = link_messages.JointStateLayout(self.tool_joints)
        self.tool_ticks = 1 if lockstep or has_jaw or wrist else _JAWLESS_TICKS
        # The track is advertised only if it is published.
        self.stale = round(track_stale * SECOND_NS / TICK_NS)
        self.frame = link_messages.text(f"{arm.name}_base")
        self.tracked = 0
        self.track: BytesPublisher | None = None
        if self.stale >= 0:
            self.track = BytesPublisher(f"{root}/rcm/track", PointVelocityStamped, lockstep)
        self._lockstep, self._receive = lockstep, receive
        self._polled: list[tuple[BytesSubscriber, Callable[[bytes], None]]] = []
        self.inputs = [
            self._subscribe("robot/servo_jv", JointState, self._on_velocity),
            self._subscribe("robot/servo_cv", TwistStamped, self._on_twist),
        ]
        self.tool_input = self._subscribe("tool/servo_jp", JointState, self._on_tool)

    def _subscribe(self, topic: str, kind: type, take: Callable[[bytes], None]) -> Any:
        name = f"/{self.name}/{topic}"

        def receive(data: bytes) -> None:
            try:
                take(data)
            except struct.error as error:
                rospy.logwarn_throttle(1.0, f"{name}: unreadable message: {error}")

        if not self._lockstep:
            polled = BytesSubscriber(name, kind)
            self._polled.append((polled, receive))
            return polled
        return rospy.Subscriber(
            name, as_bytes(kind), lambda message: receive(message.data), tcp_nodelay=True
        )

    def _on_velocity(self, data: bytes) -> None:
        stamp_ns, _, velocity = link_messages.unpack_joint_state(data)
        self._receive(self, "robot", (stamp_ns, velocity, None))

    def _on_twist(self, data: bytes) -> None:
        stamp_ns, twist = link_messages.unpack_twist(data)
        self._receive(self, "robot", (stamp_ns, None, twist))

    def _on_tool(self, data: bytes) -> None:
        stamp_ns, position, _ = link_messages.unpack_joint_state(data)
        self._receive(self, "tool", (stamp_ns, position if len(position) else None, None))

    def take_commands(self, behind: int) -> tuple[int, ArmCommand]:
        """Commands for this tick, and the robot command's stamp [ns].

        Args:
            behind: Ticks that are already due after this one, see `CommandBox.take`.
        """
        for polled, receive in self._polled:
            for data in polled.fetch():
                receive(data)
        velocity = twist = None
        robot, tool = (self.arrived[link].take(behind) for link in ("robot", "tool"))
        if robot is not None:
            self.last_command_ns, velocity, twist = robot
            self.command = "joint_velocity" if twist is None else "cartesian_velocity"
        joints = None if tool is None else tool[1]
        if joints is None:
            return self.last_command_ns, ArmCommand(velocity, twist)
        if len(joints) != len(self.tool_joints) or len(joints) == 1:
            return self.last_command_ns, ArmCommand(velocity, twist, float(joints[-1]))
        jaw, wrist = float(joints[2]), np.delete(joints, 2)
        return self.last_command_ns, ArmCommand(velocity, twist, jaw, wrist)

    @property
    def controllers(self) -> set[str]:
        """Nodes that command both the robot and the tool."""
        robot = set().union(*(speakers(subscriber) for subscriber in self.inputs))
        return robot & speakers(self.tool_input)

    def unconnected(self) -> list[str]:
        """One sentence per missing connection to the controller."""
        root = f"/{self.name}"
        missing = []
        if not any(speakers(subscriber) for subscriber in self.inputs):
            missing.append(f"nobody publishes {root}/robot/servo_jv or servo_cv (the controller)")
        if not speakers(self.tool_input):
            missing.append(f"nobody publishes {root}/tool/servo_jp (the controller)")
        controllers = self.controllers
        outputs = {"robot/measured_js": self.state, "tool/measured_js": self.tool}
        if self.track is not None:
            outputs["rcm/track"] = self.track
        for topic, output in outputs.items():
            if not output.listeners & controllers:
                hint = ", with ~track_rcm" if output is self.track else ""
                missing.append(f"the controller does not subscribe {root}/{topic}{hint}")
        return missing
