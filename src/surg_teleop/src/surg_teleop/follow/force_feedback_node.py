"""Forces at the tips to the hands: ``/<arm>/tool/measured_cf`` to ``/<leader>/servo_cf``."""

from __future__ import annotations

import threading

import numpy as np
import rospy
from geometry_msgs.msg import WrenchStamped

from surg_core.arm_view import ArmView
from surg_teleop.follow.arm_switch import Hand
from surg_teleop.follow.force_feedback import ForceFeedback
from surg_teleop.follow.teleop_setup import ASSISTANT
from surg_teleop.follow.teleop_types import CameraView, TeleopOutput, TeleopState

VIEW = "view"
"""Name of the view frame in the header."""


class ForceFeedbackTopics:
    """Relays what each instrument's tip feels while it follows its hand.

    A message goes out for each that comes in, so that silence stays silence. Stamp 0 says that
    nothing may be felt: clutched, paused, not known.
    """

    def __init__(self, hands: list[Hand], lock: threading.Lock) -> None:
        self._lock = lock
        self._felt: dict[str, ForceFeedback] = {}
        self._outputs: dict[str, rospy.Publisher] = {}
        for hand in hands:
            arm = hand.switch.instrument.settings.arm
            if arm == ASSISTANT:
                continue
            self._felt[arm] = ForceFeedback()
            self._outputs[arm] = rospy.Publisher(
                f"/{hand.leader.name}/servo_cf", WrenchStamped, queue_size=1, tcp_nodelay=True
            )
            topic = f"/{arm}/tool/measured_cf"
            rospy.Subscriber(
                topic, WrenchStamped, self._on_force, arm, queue_size=1, tcp_nodelay=True
            )

    def follow(
        self, arm: str, output: TeleopOutput, view: ArmView | None, camera: CameraView | None
    ) -> None:
        """One tick of an arm; with the lock held."""
        if (felt := self._felt.get(arm)) is None:
            return
        following = (
            output.state is TeleopState.FOLLOWING and view is not None and camera is not None
        )
        R_WB = view.R_WB if view is not None else np.eye(3)
        if felt.follow(following, R_WB, camera.R_WV if camera is not None else None):
            self._outputs[arm].publish(WrenchStamped())

    def _on_force(self, message: WrenchStamped, arm: str) -> None:
        f = message.wrench.force
        with self._lock:
            stamp = message.header.stamp
            felt = self._felt[arm].take(stamp.to_nsec(), np.array([f.x, f.y, f.z]))
        felt_message = WrenchStamped()
        felt_message.header.frame_id = VIEW
        if felt is not None:
            felt_message.header.stamp = stamp
            wrench = felt_message.wrench.force
            wrench.x, wrench.y, wrench.z = (float(v) for v in felt)
        self._outputs[arm].publish(felt_message)
