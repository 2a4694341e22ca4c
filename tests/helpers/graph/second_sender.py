"""A stranger to an arm, in a process of its own: streams beside another's stream, says words."""

from __future__ import annotations

import sys

import rospy
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Empty, String

from crtk_msgs.msg import StringStamped


def main() -> int:
    """Obeys /test/say: stream, quiet, hold, or a word for state_command.

    The stream is at 200 Hz and 1 mm beside the set-point, where it would be accepted.
    """
    rospy.init_node("stranger")
    newest: list[PoseStamped] = []
    streaming = [False]
    rospy.Subscriber("/PSM1/setpoint_cp", PoseStamped, lambda m: newest.__setitem__(slice(1), [m]))
    stream = rospy.Publisher("/PSM1/servo_cp", PoseStamped, queue_size=1, tcp_nodelay=True)
    state = rospy.Publisher("/PSM1/state_command", StringStamped, queue_size=10, tcp_nodelay=True)
    hold = rospy.Publisher("/PSM1/hold", Empty, queue_size=10, tcp_nodelay=True)

    def say(message: String) -> None:
        if message.data in ("stream", "quiet"):
            streaming[0] = message.data == "stream"
        elif message.data == "hold":
            hold.publish(Empty())
        else:
            state.publish(StringStamped(string=message.data))

    rospy.Subscriber("/test/say", String, say, tcp_nodelay=True)
    rate = rospy.Rate(200)
    while not rospy.is_shutdown():
        if streaming[0] and newest:
            message = PoseStamped()
            message.pose = newest[0].pose
            message.pose.position.y += 0.001
            stream.publish(message)
        rate.sleep()
    return 0


if __name__ == "__main__":
    sys.exit(main())
