"""A second CRTK script in a process and under a node name of its own: see ``main``."""

from __future__ import annotations

import argparse
import math
import sys
import threading

import rospy
from std_msgs.msg import Empty, String

from helpers.graph.crtk_client import Arm, LockstepTime, WallTime, position, shifted


def visit(arm: Arm) -> str:
    """Enable, home, move there and back; empty, or what did not work."""
    arm.sleep(0.02)
    if not arm.enable(2.0) or not arm.home(2.0):
        return "enable or home"
    start = arm.setpoint_cp()
    there = shifted(start, (0.0, 0.01, 0.0))
    for name, goal in (("move there", there), ("move back", start)):
        if not arm.move_cp(goal).wait(timeout=10.0):
            return name
        off = math.dist(position(arm.measured_cp()), position(goal))
        if off > 5e-4:
            return f"{name}: {off * 1e3:.3f} mm off"
    return ""


def stream(arm: Arm) -> str:
    """Enable, home, then poses on a circle at 100 Hz, placed by the clock, until the process ends.

    15 mm in 6 s: 16 mm/s. Two seconds later the circle is 26 mm away, and stays away for seconds.
    """
    arm.sleep(0.5)
    if not arm.enable(10.0) or not arm.home(10.0):
        return "enable or home"
    start, began = arm.setpoint_cp(), rospy.get_time()
    rate = rospy.Rate(100)
    while not rospy.is_shutdown():
        angle = 2 * math.pi * (rospy.get_time() - began) / 6.0
        arm.servo_cp(shifted(start, (0.015 * (1 - math.cos(angle)), 0.015 * math.sin(angle), 0.0)))
        rate.sleep()
    return ""


def main() -> int:
    """Play one of the two scripts and say on ``/test/<node>`` how it ended."""
    parser = argparse.ArgumentParser()
    parser.add_argument("script", choices=("visit", "stream"))
    parser.add_argument("--arm", default="PSM1")
    parser.add_argument("--lockstep", action="store_true")
    options = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("second")
    name = rospy.get_name()
    told = rospy.Publisher(f"/test{name}", String, latch=True, queue_size=1)
    go = threading.Event()
    rospy.Subscriber("/test/go", Empty, lambda _: go.set())
    clock = LockstepTime(name, options.arm) if options.lockstep else WallTime()
    arm = Arm(options.arm, clock)
    arm.check_connections(30.0)
    while isinstance(clock, LockstepTime) and not clock.connected():
        rospy.sleep(0.01)
    told.publish(String("connected"))
    if options.script == "stream":
        told.publish(String(stream(arm)))
        return 0
    arm.time.until(go.is_set, 3600.0)
    told.publish(String(visit(arm) or "ok"))
    while not rospy.is_shutdown():
        arm.sleep(0.1)  # the other participants' time goes on with this one
    return 0


if __name__ == "__main__":
    sys.exit(main())
