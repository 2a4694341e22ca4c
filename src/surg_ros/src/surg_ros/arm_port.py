"""The topics of an arm: cycles become `ArmView`, `ArmCommands` become messages."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from crtk_msgs.msg import StringStamped
from surg_core import WristGeometry, quaternion_xyzw_to_matrix
from surg_core.arm_view import ArmCommands, ArmState, ArmView, Array, TipPose
from surg_core.contract import POSITION_STREAMS, SECOND_NS, WRISTED_JOINTS
from surg_core.wrist_joints import WristView
from surg_msgs.msg import Cycle

KINDS: dict[str, type] = {
    "state_command": StringStamped,
    "authority/claim": Empty,
    "hold": Empty,
    "move_cp": PoseStamped,
    "jaw/servo_jp": JointState,
    "servo_cp": PoseStamped,
    "servo_jp": JointState,
}
"""Message class by topic below the arm."""
MOTION_COMMANDS = (
    *("servo_cp", "servo_jp", "servo_jr", "servo_cv", "servo_jv"),
    *("interpolate_cp", "interpolate_jp", "move_cp", "move_jp", "move_jr"),
    *("jaw/servo_jp", "jaw/move_jp", "elbow/move_jp"),
)
"""Commands with a target, which an episode keeps in ``command_<arm>.csv``."""
OTHER_COMMANDS = (
    *("state_command", "authority/claim", "servo_cp/at_wall", "tool/mount", "set_base_frame"),
    *("rcm/set_cp", "rcm/insert", "rcm/withdraw", "rcm/retrace", "rcm/track"),
    *("fixtures/set", "fixtures/remove"),
)
"""All others but ``hold``.

Only an arm's controller subscribes to these topics, and repeats on ``received`` what came.
"""
MOTION = tuple(name for name in KINDS if name != "authority/claim")
"""What a sender needs that claims no arm."""
SERVO_INSTRUMENT = ("servo_jp", "jaw/servo_jp")
"""Topics of an instrument without a controller: the assistant's."""


class ArmPort:
    """Publishers of the commands to one arm (without slashes), on topics of `KINDS` below it.

    ``out`` holds them by topic; ``sent`` counts the messages.
    """

    def __init__(self, arm: str, topics: Sequence[str] = MOTION) -> None:
        self.out = {
            name: rospy.Publisher(f"/{arm}/{name}", KINDS[name], queue_size=0, tcp_nodelay=True)
            for name in topics
        }
        self.sent = 0

    def send(self, commands: ArmCommands) -> None:
        """Send all members that are not empty."""
        stamp = rospy.Time(*divmod(commands.stamp_ns, SECOND_NS))
        if commands.state is not None:
            self._send("state_command", StringStamped(string=commands.state), stamp)
        if commands.claim:
            self._send("authority/claim", Empty())
        if commands.hold:
            self._send("hold", Empty())
        if commands.move_cp is not None:
            self._send("move_cp", pose_message(commands.move_cp), stamp)
        if commands.jaw is not None:
            self._send("jaw/servo_jp", _joints(["jaw"], [commands.jaw]), stamp)
        if commands.servo_cp is not None:
            self._send("servo_cp", pose_message(commands.servo_cp), stamp)
        if commands.servo_jp is not None:
            names = WRISTED_JOINTS[: len(commands.servo_jp)]
            self._send("servo_jp", _joints(names, commands.servo_jp.tolist()), stamp)

    def _send(self, name: str, message: Any, stamp: rospy.Time | None = None) -> None:
        if stamp is not None:
            message.header.stamp = stamp
        self.out[name].publish(message)
        self.sent += 1


def arm_view(cycle: Cycle, R_WB: Array | None = None, received: float = 0.0) -> ArmView:
    """What a cycle message reports.

    ``R_WB`` is the (3, 3) orientation of the arm's base in the world, None where it is not needed;
    ``received`` the receipt on the reader's steady clock [s].
    """
    return ArmView(
        stamp_ns=cycle.header.stamp.to_nsec(),
        state=ArmState(cycle.state),
        homed=cycle.homed,
        busy=cycle.busy,
        reason=cycle.reason,
        refused=cycle.refused,
        accepted=cycle.accepted,
        p_BTip=np.array(cycle.p_tip),
        p_BSet=np.array(cycle.p_set),
        s_B=np.array(cycle.s),
        roll=cycle.roll,
        roll_set=cycle.roll_set,
        jaw=cycle.jaw,
        jaw_set=cycle.jaw_set,
        rcm_error=cycle.rcm_error,
        p_BRcm=np.array(cycle.p_rcm),
        R_BR=_rotation(tuple(cycle.q_br)),
        R_WB=np.eye(3) if R_WB is None else R_WB,
        holder=cycle.source,
        stream=cycle.source if cycle.command == Cycle.SERVO_CP else "",
        received=received,
        p_BSample=np.array(cycle.p_goal) if cycle.command in POSITION_STREAMS else None,
        roll_sample=cycle.roll_goal,
        depth=cycle.depth,
        wrist=_wrist_view(cycle) if cycle.wrist else None,
    )


def _wrist_view(cycle: Cycle) -> WristView:
    names = ("wrist", "wrist_set", "wrist_goal", "q_tip", "q_set", "q_goal")
    values = (np.array(getattr(cycle, name)) for name in names)
    return WristView(WristGeometry(*cycle.wrist_geometry), *values)


def pose_message(pose: TipPose) -> PoseStamped:
    """A tip pose as a message; an empty frame_id means the trocar frame."""
    message = PoseStamped()
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = pose.p.tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = pose.q.tolist()
    return message


def _joints(names: Sequence[str], position: list[float]) -> JointState:
    return JointState(name=list(names), position=position)


@functools.lru_cache(maxsize=8)
def _rotation(q: tuple[float, float, float, float]) -> Array:
    """Rotation matrix, read-only; the trocar frame of an arm seldom changes."""
    R = quaternion_xyzw_to_matrix(np.array(q))
    R.setflags(write=False)
    return R
