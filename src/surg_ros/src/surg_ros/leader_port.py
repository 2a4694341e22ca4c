"""The CRTK topics of a leader: its samples as messages."""

from __future__ import annotations

import time
from collections.abc import Sequence

import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState, Joy

from surg_core.contract import SECOND_NS, VIRTUAL_JOINTS
from surg_core.hand.leader_sample import HandlePose, HandRate, LeaderSample

KINDS = {
    "measured_cp": PoseStamped,
    "measured_cv": TwistStamped,
    "spherical/measured_js": JointState,
    "gripper/measured_js": JointState,
}


class LeaderTopics:
    """Publishes the samples of a leader, `spherical` those that turn the shaft about the trocar."""

    def __init__(self, name: str, spherical: bool = True) -> None:
        self._out = {
            topic: rospy.Publisher(f"/{name}/{topic}", kind, queue_size=1, tcp_nodelay=True)
            for topic, kind in KINDS.items()
            if spherical or topic != "spherical/measured_js"
        }

    def publish(self, sample: LeaderSample, stamp: rospy.Time) -> None:
        """Publish what the sample has; a grip of 1 is a gripper at 1 rad."""
        if sample.pose is not None:
            self._send("measured_cp", pose_message(sample.pose), stamp)
        if sample.rate is not None and sample.rate.spherical is not None:
            velocity = [*sample.rate.spherical.tolist(), sample.rate.roll]
            joints = JointState(name=list(VIRTUAL_JOINTS), velocity=velocity)
            self._send("spherical/measured_js", joints, stamp)
        elif sample.rate is not None:
            self._send("measured_cv", rate_message(sample.rate), stamp)
        if sample.grip is not None:
            gripper = JointState(name=["gripper"], position=[sample.grip])
            self._send("gripper/measured_js", gripper, stamp)

    def _send(
        self, topic: str, message: PoseStamped | TwistStamped | JointState, stamp: rospy.Time
    ) -> None:
        message.header.stamp = stamp
        self._out[topic].publish(message)


def pose_message(pose: HandlePose) -> PoseStamped:
    """A handle's pose in V."""
    message = PoseStamped()
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = pose.p_VH.tolist()
    q.x, q.y, q.z, q.w = pose.q_VH.tolist()
    return message


def rate_message(rate: HandRate) -> TwistStamped:
    """A hand's rate in V; the roll is the angular velocity about z, the tilt that about x and y."""
    message = TwistStamped()
    v = message.twist.linear
    v.x, v.y, v.z = rate.v_V.tolist()
    message.twist.angular.z = rate.roll
    if rate.tilt is not None:
        message.twist.angular.x, message.twist.angular.y = rate.tilt.tolist()
    return message


def joy_message(buttons: Sequence[int], stamp: rospy.Time, axes: Sequence[float] = ()) -> Joy:
    """Buttons, 0 or 1, and axes."""
    message = Joy(axes=list(axes), buttons=[int(button) for button in buttons])
    message.header.stamp = stamp
    return message


def wall_time() -> rospy.Time:
    """The wall clock, whatever ``/use_sim_time`` says."""
    return rospy.Time(*divmod(time.time_ns(), SECOND_NS))
