"""Drives an emulated FER with PyPI's `panda-python` (libfranka 0.9.2), in its own environment.

Prints one line of JSON: figure -> value. Call: `python panda_python_client.py ADDRESS ERROR ...`
with the names of the errors that the emulator raises, in their order.
"""

import json
import sys

from libfranka_client_parts import PERIOD, STEP, ask_priority, faults, settings, wave
from panda_py import libfranka

MODES = libfranka.RobotMode.kUserStopped, libfranka.RobotMode.kIdle, libfranka.RobotMode.kGuiding
RAW = {"limit_rate": False, "cutoff_frequency": 1000.0}


def run(robot, profile, seconds, **options):
    """A motion of joint 1 by a profile of its velocity; what libfranka says, empty if nothing."""
    passed = [0.0]

    def command(state, duration):
        passed[0] += duration.to_sec()
        last = passed[0] >= seconds
        speed = 0.0 if last else profile(passed[0])
        wanted = libfranka.JointVelocities([speed, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        return libfranka.motion_finished(wanted) if last else wanted

    try:
        robot.control_joint_velocity(command, **options)
    except RuntimeError as error:
        return str(error)
    return ""


def rest(now):
    """No motion."""
    return 0.0


def step(now):
    """Two steps without a ramp, back to rest [rad/s]."""
    return STEP if now < 0.2 else 0.0


def model(robot):
    """What libfranka says when it asks for the model library."""
    try:
        robot.load_model()
    except RuntimeError as error:
        return str(error)
    return ""


def main(address, names):
    """All figures."""
    ask_priority()
    robot = libfranka.Robot(address, libfranka.RealtimeConfig.kIgnore)
    found = {"version": robot.server_version(), "q": robot.read_once().q}
    found["settings"] = settings(robot, robot.set_ee)
    before = robot.read_once().q
    found["said"] = run(robot, wave, PERIOD, **RAW)
    after = robot.read_once().q
    found["way"] = [b - a for a, b in zip(before, after, strict=True)]
    found["step"] = run(robot, step, 0.4, **RAW)
    found["in_reflex"] = run(robot, rest, 0.1)
    robot.automatic_error_recovery()
    found["limited_step"] = run(robot, step, 0.6, limit_rate=True, cutoff_frequency=1000.0)
    found |= faults(address, robot, lambda: run(robot, rest, 0.6), MODES, names)
    found["model"] = model(robot)
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
