"""Beside the robot: writes every control cycle down. ``near_eye.py ARM LOG``, until stdin ends.

A line of LOG: steady time of receipt [s], tick, stamp [ns], accepted, refused, state, reason or
``-``, x, y, z of the set-point and of the tip in the rcm frame [m], period of the cycle [s].
"""

from __future__ import annotations

import sys
import time

import numpy as np
import rospy

from surg_core import quaternion_xyzw_to_matrix
from surg_msgs.msg import Cycle


def main(arm: str, log: str) -> int:
    """Listens until stdin ends."""
    rospy.init_node("near_eye", disable_signals=True)
    with open(log, "w", buffering=1, encoding="utf-8") as file:

        def write(cycle: Cycle) -> None:
            now = time.monotonic()
            R_RB = quaternion_xyzw_to_matrix(np.array(cycle.q_br)).T
            places = [R_RB @ (np.array(p) - cycle.p_rcm) for p in (cycle.p_set, cycle.p_tip)]
            numbers = " ".join(f"{value:.9f}" for value in np.concatenate(places))
            head = f"{now:.6f} {cycle.tick} {cycle.header.stamp.to_nsec()} {cycle.accepted}"
            tail = f"{cycle.refused} {cycle.state} {cycle.reason or '-'}"
            file.write(f"{head} {tail} {numbers} {1e-6 * cycle.period_us:.6f}\n")

        subscriber = rospy.Subscriber(f"/{arm}/cycle", Cycle, write, tcp_nodelay=True)
        print("up", flush=True)
        sys.stdin.read()
        subscriber.unregister()
    rospy.signal_shutdown("done")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2]))
