"""Drives an emulated UR arm with PyPI's `urx`; runs in an environment of its own.

Prints one line of JSON: figure -> value. Call: `python urx_client.py ADDRESS`.
"""

import json
import sys
import time

import urx

PERIOD = 0.1
"""Of the states [s]."""


def settled(robot):
    """Joint positions once they no longer change [rad]."""
    last = robot.getj(wait=True)
    for _ in range(100):
        time.sleep(2.0 * PERIOD)
        now = robot.getj(wait=True)
        if now == last:
            return now
        last = now
    raise AssertionError("the arm does not come to rest")


def main():
    """Read the state, move, stop; print the figures."""
    robot = urx.Robot(sys.argv[1])
    place = robot.secmon.get_all_data(wait=True)["CartesianInfo"]
    found = {"joints": robot.getj(wait=True), "place": [place[axis] for axis in "XYZ"]}
    goal = [q + 0.2 for q in found["joints"]]
    robot.movej(goal, acc=1.0, vel=1.0, wait=False)
    time.sleep(3.0 * PERIOD)
    found["move_error"] = max(abs(a - b) for a, b in zip(settled(robot), goal, strict=True))
    robot.send_program("speedj([0.2, 0, 0, 0, 0, 0], 2.0, 30)")
    time.sleep(1.0)
    first, begin = robot.getj(wait=True)[0], time.monotonic()
    time.sleep(1.0)
    found["rate"] = (robot.getj(wait=True)[0] - first) / (time.monotonic() - begin)
    robot.stopj(2.0)
    time.sleep(3.0 * PERIOD)
    settled(robot)
    robot.close()
    print(json.dumps(found))


main()
