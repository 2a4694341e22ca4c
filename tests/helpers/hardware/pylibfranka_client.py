"""Drives an emulated FR3 with PyPI's `pylibfranka`; runs in an environment of its own.

Prints one line of JSON: figure -> value. Call: `python pylibfranka_client.py ADDRESS ERROR ...`
with the names of the errors that the emulator raises, in their order.
"""

import json
import sys
import time

import pylibfranka
from libfranka_client_parts import PERIOD, STEP, ask_priority, faults, settings, until, wave
from pylibfranka import RobotMode

MODES = RobotMode.UserStopped, RobotMode.Idle, RobotMode.Guiding


def run(robot, profile, seconds):
    """A motion of joint 1 by a profile of its velocity; what libfranka says, empty if nothing."""
    passed, last = 0.0, False
    try:
        control = robot.start_joint_velocity_control(pylibfranka.ControllerMode.JointImpedance)
        while not last:
            _, duration = control.readOnce()
            passed += duration.to_sec()
            last = passed >= seconds
            speed = 0.0 if last else profile(passed)
            command = pylibfranka.JointVelocities([speed, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
            command.motion_finished = last
            control.writeOnce(command)
    except (pylibfranka.ControlException, pylibfranka.CommandException) as error:
        return str(error)
    return ""


def rest(now):
    """No motion."""
    return 0.0


def main(address, names):
    """All figures."""
    ask_priority()
    robot = pylibfranka.Robot(address, pylibfranka.RealtimeConfig.kIgnore)
    found = {"q": list(robot.read_once().q), "settings": settings(robot, robot.set_EE)}
    state = robot.read_once()
    found["jacobian"] = list(robot.load_model().zero_jacobian(state))
    found["said"] = run(robot, wave, PERIOD)
    until(robot, RobotMode.Idle)
    time.sleep(0.1)
    after = robot.read_once().q
    found["way"] = [b - a for a, b in zip(state.q, after, strict=True)]
    found["step"] = run(robot, lambda now: STEP, 0.2)
    found["in_reflex"] = run(robot, rest, 0.1)
    robot.automatic_error_recovery()
    found |= faults(address, robot, lambda: run(robot, rest, 0.6), MODES, names)
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
