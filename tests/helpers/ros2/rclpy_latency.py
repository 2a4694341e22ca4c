"""Real rclpy: sends 3000 poses at 500 Hz, then hears as many and prints how late each was [s]."""

from __future__ import annotations

import json
import time

import rclpy
from geometry_msgs.msg import PoseStamped

POSES, PERIOD_S, SETTLE_S, SILENT_S = 3000, 0.002, 3.0, 2.0


def main() -> None:
    """Send, then hear until nothing comes any more."""
    rclpy.init()
    node = rclpy.create_node("latency")
    publisher = node.create_publisher(PoseStamped, "/PSM1/servo_cp", 10)
    while not publisher.get_subscription_count():
        time.sleep(0.05)
    time.sleep(SETTLE_S)  # its node in ROS 1 connects
    begin, pose = time.time(), PoseStamped()
    for k in range(POSES):
        time.sleep(max(0.0, begin + PERIOD_S * k - time.time()))
        nanoseconds = time.time_ns()
        pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(nanoseconds, 10**9)
        publisher.publish(pose)
    time.sleep(SILENT_S)
    print("said", flush=True)
    late: list[float] = []
    heard = [0.0]

    def hear(message: PoseStamped) -> None:
        heard[0] = time.time()
        stamp = message.header.stamp
        late.append(heard[0] - stamp.sec - stamp.nanosec * 1e-9)

    node.create_subscription(PoseStamped, "/PSM1/measured_cp", hear, 10)
    while not late or time.time() - heard[0] < SILENT_S:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(json.dumps(late), flush=True)


if __name__ == "__main__":
    main()
