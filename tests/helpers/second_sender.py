"""A stranger to an arm, in a process of its own: streams sideways, and later says one word."""

from __future__ import annotations

import sys

import rospy
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Empty, String

from crtk_msgs.msg import StringStamped


def main() -> int:
    """Streams poses 1 mm beside the set-point at 200 Hz; obeys /test/say: hold, pause, disable."""
    rospy.init_node("stranger")
    newest: list[PoseStamped] = []
    rospy.Subscriber("/PSM1/setpoint_cp", PoseStamped, lambda m: newest.__setitem__(slice(0), [m]))
    stream = rospy.Publisher("/PSM1/servo_cp", PoseStamped, queue_size=1)
    state = rospy.Publisher("/PSM1/state_command", StringStamped, queue_size=10)
    hold = rospy.Publisher("/PSM1/hold", Empty, queue_size=10)

    def say(message: String) -> None:
        if message.data == "hold":
            hold.publish(Empty())
        else:
            state.publish(StringStamped(string=message.data))

    rospy.Subscriber("/test/say", String, say)
    rate = rospy.Rate(200)
    while not rospy.is_shutdown():
        if newest:
            message = PoseStamped()
            message.pose = newest[0].pose
            message.pose.position.y += 0.001
            stream.publish(message)
        rate.sleep()
    return 0


if __name__ == "__main__":
    sys.exit(main())
