"""The topics of an arm: what it says becomes an ArmView, Commands become messages."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from crtk_msgs.msg import StringStamped
from surg_core import quaternion_xyzw_to_matrix
from surg_core.contract import SECOND_NS
from surg_msgs.msg import Cycle
from surg_teleop.follow.arm_view import ArmState, ArmView, Commands, Pose

COMMANDS = {
    "state_command": StringStamped,
    "move_cp": PoseStamped,
    "servo_cp": PoseStamped,
    "servo_jp": JointState,
    "jaw/servo_jp": JointState,
    "hold": Empty,
}
"""What a sender of a motion needs."""


def wait_for_all(
    missing: Callable[[], str], timeout: float, over: Callable[[], bool] = rospy.is_shutdown
) -> None:
    """Wait until nobody is missing.

    Args:
        missing: Who is, in words; empty: nobody.
        timeout: [s]
        over: Whether there is nothing left to wait for.

    Raises:
        TimeoutError: Somebody is missing; says who.
    """
    deadline = time.monotonic() + timeout
    while text := missing():
        if time.monotonic() > deadline or over():
            raise TimeoutError(f"no connection after {timeout:.0f} s: {text}")
        time.sleep(0.02)


class ArmPort:
    """Publishers of one arm.

    Args:
        arm: The arm's namespace, without slashes.
        claims: True: authority is claimed as well.
        only: The topics that there are; empty: all.

    Attributes:
        out: Publishers by topic below the arm.
        sent: Messages sent so far.
    """

    def __init__(self, arm: str, claims: bool = False, only: Sequence[str] = ()) -> None:
        kinds = {**COMMANDS, **({"authority/claim": Empty} if claims else {})}
        kinds = {name: kind for name, kind in kinds.items() if name in only or not only}
        self.out = {
            name: rospy.Publisher(f"/{arm}/{name}", kind, queue_size=0, tcp_nodelay=True)
            for name, kind in kinds.items()
        }
        self.sent = 0

    def send(self, commands: Commands) -> None:
        """Sends what there is to send."""
        stamp = rospy.Time(*divmod(commands.stamp_ns, SECOND_NS))
        if commands.state is not None:
            self._stamped("state_command", StringStamped(string=commands.state), stamp)
        if commands.claim:
            self._send("authority/claim", Empty())
        if commands.move_cp is not None:
            self._stamped("move_cp", pose_message(commands.move_cp), stamp)
        if commands.servo_cp is not None:
            self._stamped("servo_cp", pose_message(commands.servo_cp), stamp)
        if commands.servo_jp is not None:
            joints = JointState(
                name=["yaw", "pitch", "insertion", "roll"], position=commands.servo_jp.tolist()
            )
            self._stamped("servo_jp", joints, stamp)
        if commands.jaw is not None:
            self._stamped("jaw/servo_jp", JointState(name=["jaw"], position=[commands.jaw]), stamp)
        if commands.hold:
            self._send("hold", Empty())

    def _stamped(
        self, name: str, message: StringStamped | PoseStamped | JointState, stamp: rospy.Time
    ) -> None:
        message.header.stamp = stamp
        self._send(name, message)

    def _send(self, name: str, message: object) -> None:
        self.out[name].publish(message)
        self.sent += 1


@functools.lru_cache(maxsize=8)
def _rotation(q: tuple[float, float, float, float]) -> np.ndarray:
    """Rotation matrix, read-only: an arm's rcm frame is where it was, unless it is tracked."""
    R = quaternion_xyzw_to_matrix(np.array(q))
    R.setflags(write=False)
    return R


def arm_view(cycle: Cycle, R_WB: np.ndarray | None = None, received: float = 0.0) -> ArmView:
    """What a sender looks at in a cycle message.

    Args:
        cycle: The message.
        R_WB: (3, 3) the arm's base in the world of the cell; None: it is not asked for.
        received: When it came, on the steady clock [s].
    """
    R_BR = _rotation(tuple(cycle.q_br))
    p_BRcm = np.array(cycle.p_rcm)
    return ArmView(
        stamp_ns=cycle.header.stamp.to_nsec(),
        state=ArmState(cycle.state),
        homed=cycle.homed,
        busy=cycle.busy,
        reason=cycle.reason,
        refused=cycle.refused,
        p_set=R_BR.T @ (np.array(cycle.p_set) - p_BRcm),
        p_tip=R_BR.T @ (np.array(cycle.p_tip) - p_BRcm),
        roll_set=cycle.roll_set,
        jaw_set=cycle.jaw_set,
        holder=cycle.source,
        stream=cycle.source if cycle.command == Cycle.SERVO_CP else "",
        R_WR=R_BR if R_WB is None else R_WB @ R_BR,
        received=received,
    )


def pose_message(pose: Pose) -> PoseStamped:
    """A pose in the rcm frame as a message; an empty frame_id means that frame."""
    message = PoseStamped()
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = pose.p.tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = pose.q.tolist()
    return message
