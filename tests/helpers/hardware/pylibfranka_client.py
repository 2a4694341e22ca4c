"""Drives an emulated FR3 with PyPI's `pylibfranka`; runs in an environment of its own.

Prints one line of JSON: figure -> value. Call: `python pylibfranka_client.py ADDRESS ERROR ...`
with the names of the errors that the emulator raises, in their order.
"""

import contextlib
import json
import math
import os
import socket
import sys
import time

import pylibfranka

PERIOD, SPEED = 2.0, 0.1
STEP = 0.05  # rad/s; its acceleration is 50 rad/s^2


def mishap(address, line):
    """One line to the emulator's control port; its answer."""
    with socket.create_connection((address, 29990), timeout=5.0) as control:
        control.sendall(f"{line}\n".encode())
        return control.makefile().readline().strip()


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


def wave(now):
    """From rest to rest with a mean of SPEED [rad/s]."""
    return SPEED * (1.0 - math.cos(2.0 * math.pi * now / PERIOD))


def until(robot, mode, seconds=3.0):
    """Wait for a robot mode; the mode's name at the end."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and robot.read_once().robot_mode != mode:
        time.sleep(0.01)
    return robot.read_once().robot_mode.name


def during(address, robot, line):
    """What libfranka says of a mishap 0.1 s after the start of a motion at rest."""
    assert mishap(address, f"at 0.1 {line}") == "ok"
    return run(robot, lambda now: 0.0, 0.6)


def settings(robot):
    """Settings through their state: load, frames, pose of the end effector."""
    frame = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.01, 0.02, 0.1, 1]
    robot.set_load(0.7, [0.01, 0.02, 0.03], [0.1, 0, 0, 0, 0.2, 0, 0, 0, 0.3])
    before = list(robot.read_once().O_T_EE)
    robot.set_EE(frame)
    robot.set_collision_behavior([20.0] * 7, [20.0] * 7, [10.0] * 6, [10.0] * 6)
    robot.set_joint_impedance([3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0])
    state = robot.read_once()
    return {
        "load": [state.m_load, *state.F_x_Cload, *state.I_load],
        "frame": list(state.F_T_EE),
        "before": before,
        "after": list(state.O_T_EE),
    }


def main(address, names):
    """All figures."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    robot = pylibfranka.Robot(address, pylibfranka.RealtimeConfig.kIgnore)
    found = {"q": list(robot.read_once().q), "settings": settings(robot)}
    model, state = robot.load_model(), robot.read_once()
    found["jacobian"] = list(model.zero_jacobian(state))
    before = list(state.q)
    found["said"] = run(robot, wave, PERIOD)
    until(robot, pylibfranka.RobotMode.Idle)
    time.sleep(0.1)
    after = robot.read_once().q
    found["way"] = [b - a for a, b in zip(before, after, strict=True)]
    found["step"] = run(robot, lambda now: STEP, 0.2)
    found["in_reflex"] = run(robot, lambda now: 0.0, 0.1)
    robot.automatic_error_recovery()
    found["errors"] = {}
    for name in names:
        found["errors"][name] = during(address, robot, f"reflex {name}")
        robot.automatic_error_recovery()
    found["burst"] = during(address, robot, "burst 40 commands")
    robot.automatic_error_recovery()
    found["user_stop"] = during(address, robot, "user_stop on")
    found["user_stopped"] = until(robot, pylibfranka.RobotMode.UserStopped)
    mishap(address, "user_stop off")
    found["released"] = until(robot, pylibfranka.RobotMode.Idle)
    mishap(address, "guide on 0.2 0 0 0 0 0 0")
    found["guided"] = until(robot, pylibfranka.RobotMode.Guiding)
    mishap(address, "guide off")
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
