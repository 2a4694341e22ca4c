"""Prints where a tip is, fifty times a second: `python tip_printer.py PSM1`, rcm frame, metres.

A process of its own, because a test's own node belongs to another ROS master.
"""

from __future__ import annotations

import sys
import time

import rospy
from geometry_msgs.msg import PoseStamped


def main() -> None:
    """Print until the pipe ends."""
    newest: list[PoseStamped] = []
    rospy.init_node("tip_printer", anonymous=True, disable_signals=True)

    def keep(message: PoseStamped) -> None:
        newest[:] = [message]

    rospy.Subscriber(f"/{sys.argv[1]}/local/measured_cp", PoseStamped, keep, tcp_nodelay=True)
    while not rospy.is_shutdown():
        if newest:
            p = newest[0].pose.position
            print(f"{time.monotonic():.4f} {p.x:.6f} {p.y:.6f} {p.z:.6f}", flush=True)
        time.sleep(0.02)


if __name__ == "__main__":
    main()
