"""Drives an emulated FER with PyPI's `panda-python` (libfranka 0.9.2), in its own environment.

Prints one line of JSON: figure -> value. Call: `python panda_python_client.py ADDRESS ERROR ...`
with the names of the errors that the emulator raises, in their order.
"""

import contextlib
import json
import math
import os
import socket
import sys
import time

from panda_py import libfranka

PERIOD, SPEED = 2.0, 0.1
STEP = 0.05  # rad/s; its acceleration is 50 rad/s^2


def mishap(address, line):
    """One line to the emulator's control port; its answer."""
    with socket.create_connection((address, 29990), timeout=5.0) as control:
        control.sendall(f"{line}\n".encode())
        return control.makefile().readline().strip()


def velocities(speed, last=False):
    """A command of joint 1, the last one of a motion or not."""
    command = libfranka.JointVelocities([speed, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    return libfranka.motion_finished(command) if last else command


def run(robot, profile, seconds, **options):
    """A motion of joint 1 by a profile of its velocity; what libfranka says, empty if nothing."""
    passed = [0.0]

    def command(state, duration):
        passed[0] += duration.to_sec()
        last = passed[0] >= seconds
        return velocities(0.0 if last else profile(passed[0]), last)

    try:
        robot.control_joint_velocity(command, **options)
    except RuntimeError as error:
        return str(error)
    return ""


def wave(now):
    """From rest to rest with a mean of SPEED [rad/s]."""
    return SPEED * (1.0 - math.cos(2.0 * math.pi * now / PERIOD))


def step(now):
    """Two steps without a ramp, back to rest [rad/s]."""
    return STEP if now < 0.2 else 0.0


def smooth(robot):
    """What libfranka says of a smooth motion, and its way [rad]."""
    before = robot.read_once().q
    said = run(robot, wave, PERIOD, limit_rate=False, cutoff_frequency=1000.0)
    after = robot.read_once().q
    return {"said": said, "way": [b - a for a, b in zip(before, after, strict=True)]}


def during(address, robot, line):
    """What libfranka says of a mishap 0.1 s after the start of a motion at rest."""
    assert mishap(address, f"at 0.1 {line}") == "ok"
    return run(robot, lambda now: 0.0, 0.6)


def until(robot, mode, seconds=3.0):
    """Wait for a robot mode; the mode's name at the end."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and robot.read_once().robot_mode != mode:
        time.sleep(0.01)
    return robot.read_once().robot_mode.name


def settings(robot):
    """Settings through their state: load, frames, pose of the end effector."""
    frame = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.01, 0.02, 0.1, 1]
    robot.set_load(0.7, [0.01, 0.02, 0.03], [0.1, 0, 0, 0, 0.2, 0, 0, 0, 0.3])
    before = robot.read_once().O_T_EE
    robot.set_ee(frame)
    robot.set_collision_behavior([20.0] * 7, [20.0] * 7, [10.0] * 6, [10.0] * 6)
    robot.set_joint_impedance([3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0])
    state = robot.read_once()
    return {
        "load": [state.m_load, *state.F_x_Cload, *state.I_load],
        "frame": state.F_T_EE,
        "before": before,
        "after": state.O_T_EE,
    }


def refused(call):
    """What libfranka says of a call that is refused."""
    try:
        call()
    except RuntimeError as error:
        return str(error)
    return ""


def main(address, names):
    """All figures."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    robot = libfranka.Robot(address, libfranka.RealtimeConfig.kIgnore)
    found = {"version": robot.server_version(), "q": robot.read_once().q}
    found["settings"] = settings(robot)
    found["smooth"] = smooth(robot)
    found["step"] = run(robot, step, 0.4, limit_rate=False, cutoff_frequency=1000.0)
    found["in_reflex"] = run(robot, lambda now: 0.0, 0.1)
    robot.automatic_error_recovery()
    found["limited_step"] = run(robot, step, 0.6, limit_rate=True, cutoff_frequency=1000.0)
    found["errors"] = {}
    for name in names:
        found["errors"][name] = during(address, robot, f"reflex {name}")
        robot.automatic_error_recovery()
    found["burst"] = during(address, robot, "burst 40 commands")
    robot.automatic_error_recovery()
    found["user_stop"] = during(address, robot, "user_stop on")
    found["user_stopped"] = until(robot, libfranka.RobotMode.kUserStopped)
    mishap(address, "user_stop off")
    found["released"] = until(robot, libfranka.RobotMode.kIdle)
    mishap(address, "guide on 0.2 0 0 0 0 0 0")
    found["guided"] = until(robot, libfranka.RobotMode.kGuiding)
    mishap(address, "guide off")
    found["model"] = refused(robot.load_model)
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
