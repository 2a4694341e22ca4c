"""``endoscope_left`` and ``endoscope_right`` on /tf_static, where calibration says they are.

The node ``/endoscope`` publishes them, of a simulated endoscope as of a real one.
"""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Transform, TransformStamped
from tf2_msgs.msg import TFMessage

import surg_core
from surg_core.held_endoscope import LEFT, RIGHT, HeldEndoscope, held_endoscope
from surg_core.transforms import FloatArray, matrix_to_quaternion_xyzw

Frame = tuple[str, str, FloatArray]
"""Parent, child, pose (4, 4) of the child in the parent [m]."""


def frames_of(held: HeldEndoscope | None, X_WV: FloatArray | None = None) -> list[Frame]:
    """The endoscope's frames: on the arm that holds it, or in the world.

    Args:
        held: The arm's endoscope; None: no arm holds one.
        X_WV: (4, 4) the left camera of an endoscope that stands still; None: unknown.
    """
    if held is None:
        return [] if X_WV is None else [("world", LEFT, X_WV)]
    if held.X_FV is None:
        return []
    frames = [(f"{held.arm}_flange", LEFT, held.X_FV)]
    return frames if held.X_LR is None else [*frames, (LEFT, RIGHT, held.X_LR)]


class EndoscopeTf:
    """Publishes the frames once, latched; they hold as long as this object lives."""

    def __init__(self, cell: surg_core.Cell, X_WV: FloatArray | None = None) -> None:
        self._publisher = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        held = None
        try:
            held = held_endoscope(cell)
        except surg_core.ConfigError as error:
            rospy.logerr(f"endoscope: no {LEFT} on /tf: {error}")
            return
        if held is not None and held.X_FV is None:
            rospy.logwarn(
                f"endoscope: no {LEFT} on /tf: camera_{held.arm}.yaml states a rotation only; "
                "run ./surg calibrate CELL handeye"
            )
        if frames := frames_of(held, X_WV):
            self._publisher.publish(TFMessage([_message(*frame) for frame in frames]))


def _message(parent: str, child: str, X: FloatArray) -> TransformStamped:
    message = TransformStamped(child_frame_id=child, transform=Transform())
    message.header.frame_id, message.header.stamp = parent, rospy.Time.now()
    to, turn = message.transform.translation, message.transform.rotation
    to.x, to.y, to.z = np.asarray(X[:3, 3]).tolist()
    turn.x, turn.y, turn.z, turn.w = matrix_to_quaternion_xyzw(X[:3, :3]).tolist()
    return message
