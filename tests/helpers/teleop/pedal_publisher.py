"""A pedal node as `leader_node.py` is one: says 20 times a second that its clutch is up."""

from __future__ import annotations

import rospy
from sensor_msgs.msg import Joy


def main() -> None:
    """Until it is killed."""
    rospy.init_node("feet")
    clutch = rospy.Publisher("/footpedals/clutch", Joy, queue_size=10, tcp_nodelay=True)
    rate = rospy.Rate(20.0)
    while not rospy.is_shutdown():
        clutch.publish(Joy(buttons=[0]))
        rate.sleep()


if __name__ == "__main__":
    main()
