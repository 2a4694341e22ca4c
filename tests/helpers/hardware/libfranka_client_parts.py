"""What the clients of both libfrankas have in common; runs in their environments, not in ours."""

import contextlib
import math
import os
import socket
import time

PERIOD, SPEED = 2.0, 0.1
STEP = 0.05  # rad/s; its acceleration is 50 rad/s^2
FRAME = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.01, 0.02, 0.1, 1]
STIFFNESS = [3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0]


def ask_priority():
    """Real-time priority, where it is granted."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))


def fault(address, line):
    """One line to the emulator's control port; its answer."""
    with socket.create_connection((address, 29990), timeout=5.0) as control:
        control.sendall(f"{line}\n".encode())
        return control.makefile().readline().strip()


def wave(now):
    """From rest to rest with a mean of SPEED [rad/s]."""
    return SPEED * (1.0 - math.cos(2.0 * math.pi * now / PERIOD))


def until(robot, mode, seconds=3.0):
    """Wait for a robot mode; the mode's name at the end."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and robot.read_once().robot_mode != mode:
        time.sleep(0.01)
    return robot.read_once().robot_mode.name


def settings(robot, set_end_effector):
    """Settings through their state: load, frame, pose of the end effector before and after."""
    robot.set_load(0.7, [0.01, 0.02, 0.03], [0.1, 0, 0, 0, 0.2, 0, 0, 0, 0.3])
    before = list(robot.read_once().O_T_EE)
    set_end_effector(FRAME)
    robot.set_collision_behavior([20.0] * 7, [20.0] * 7, [10.0] * 6, [10.0] * 6)
    robot.set_joint_impedance(STIFFNESS)
    state = robot.read_once()
    return {
        "load": [state.m_load, *state.F_x_Cload, *state.I_load],
        "frame": list(state.F_T_EE),
        "before": before,
        "after": list(state.O_T_EE),
    }


def faults(address, robot, move, modes, names):
    """What libfranka says of errors, lost packets and people.

    Args:
        address: The emulator's.
        robot: Connected.
        move: Moves at rest for 0.6 s; returns what libfranka says.
        modes: libfranka's modes: user stopped, idle, guiding.
        names: Of the errors to raise.
    """

    def during(line):
        assert fault(address, f"at 0.1 {line}") == "ok"
        return move()

    found = {"errors": {}}
    for name in names:
        found["errors"][name] = during(f"reflex {name}")
        robot.automatic_error_recovery()
    found["burst"] = during("burst 40 commands")
    robot.automatic_error_recovery()
    found["user_stop"] = during("user_stop on")
    lines = (None, "user_stop off", "guide on 0.2 0 0 0 0 0 0")
    for name, line, mode in zip(("user_stopped", "released", "guided"), lines, modes, strict=True):
        if line:
            fault(address, line)
        found[name] = until(robot, mode)
    fault(address, "guide off")
    return found
