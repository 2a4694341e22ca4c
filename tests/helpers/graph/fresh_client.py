"""A program that greets an arm for the first time, with crtk_python_client unmodified.

`fresh_client.py move|servo X`: prints JSON: whether `wait()` was true, and the distance from the
goal [m], which lies X metres along x from the set-point.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import crtk
import PyKDL
import rospy

SAMPLES = 25
"""Samples of a stream, at 100 Hz."""


class Arm:
    """What the client's own examples make."""

    def __init__(self, ral: Any) -> None:
        self.utils = crtk.utils(self, ral)
        for interface in ("operating_state", "setpoint_cp", "measured_cp", "move_cp", "servo_cp"):
            getattr(self.utils, f"add_{interface}")()


def main(kind: str, way: float) -> None:
    """Check the connections, enable, home, command at once."""
    ral = crtk.ral("fresh_client")
    arm: Any = Arm(ral.create_child("PSM1"))
    ral.check_connections(10)
    arm.enable(10)
    arm.home(10)
    goal = PyKDL.Frame(arm.setpoint_cp()[0])
    begin = goal.p[0]
    if kind == "move":
        goal.p[0] = begin + way
        done = arm.move_cp(goal).wait(timeout=10.0)
    else:
        for k in range(1, SAMPLES + 1):
            goal.p[0] = begin + way * k / SAMPLES
            arm.servo_cp(goal)
            time.sleep(0.01)
        time.sleep(0.5)
        done = True
    print(json.dumps({"done": done, "off": (arm.measured_cp()[0].p - goal.p).Norm()}))
    rospy.signal_shutdown("done")


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
