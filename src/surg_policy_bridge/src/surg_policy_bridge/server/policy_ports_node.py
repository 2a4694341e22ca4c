"""The topics of an arm: what it says becomes an `ArmView`, an `ArmCommand` becomes messages."""

from __future__ import annotations

from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from crtk_msgs.msg import StringStamped
from surg_core import quaternion_xyzw_to_matrix, tip_quaternion
from surg_core.contract import SECOND_NS
from surg_msgs.msg import Cycle
from surg_policy_bridge.server.policy_arm import ArmCommand, ArmState, ArmView

COMMANDS = {
    "state_command": StringStamped,
    "authority/claim": Empty,
    "servo_cp": PoseStamped,
    "jaw/servo_jp": JointState,
    "hold": Empty,
}


def view_of(cycle: Cycle) -> ArmView:
    """What a cycle says, in the rcm frame."""
    R_BR = quaternion_xyzw_to_matrix(np.array(cycle.q_br))
    p_BRcm = np.array(cycle.p_rcm)
    return ArmView(
        stamp_ns=cycle.header.stamp.to_nsec(),
        state=ArmState(cycle.state),
        homed=cycle.homed,
        reason=cycle.reason,
        holder=cycle.source,
        p_tip=R_BR.T @ (np.array(cycle.p_tip) - p_BRcm),
        roll=cycle.roll,
        jaw=cycle.jaw,
        p_set=R_BR.T @ (np.array(cycle.p_set) - p_BRcm),
        roll_set=cycle.roll_set,
        jaw_set=cycle.jaw_set,
        rcm_error=cycle.rcm_error,
        refused=cycle.refused,
    )


class ArmPort:
    """Publishers of one arm.

    Args:
        arm: Its name.

    Attributes:
        out: Publishers by topic below the arm.
        sent: Messages sent so far.
    """

    def __init__(self, arm: str) -> None:
        self.out = {
            name: rospy.Publisher(f"/{arm}/{name}", kind, queue_size=0, tcp_nodelay=True)
            for name, kind in COMMANDS.items()
        }
        self.sent = 0

    def send(self, command: ArmCommand, stamp_ns: int) -> None:
        """Send what there is to send."""
        stamp = rospy.Time(*divmod(stamp_ns, SECOND_NS))
        if command.hold:
            self._send("hold", Empty())
        if command.state:
            self._stamped("state_command", StringStamped(string=command.state), stamp)
        if command.claim:
            self._send("authority/claim", Empty())
        target = command.servo
        if target is not None:
            jaw = JointState(name=["jaw"], position=[target.jaw])
            self._stamped("jaw/servo_jp", jaw, stamp)
            pose = PoseStamped()
            position, orientation = pose.pose.position, pose.pose.orientation
            position.x, position.y, position.z = target.p.tolist()
            q = tip_quaternion(target.p, target.roll).tolist()
            orientation.x, orientation.y, orientation.z, orientation.w = q
            self._stamped("servo_cp", pose, stamp)

    def _stamped(self, name: str, message: Any, stamp: rospy.Time) -> None:
        message.header.stamp = stamp
        self._send(name, message)

    def _send(self, name: str, message: Any) -> None:
        self.out[name].publish(message)
        self.sent += 1
