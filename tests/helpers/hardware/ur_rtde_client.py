"""Drives an emulated UR arm with PyPI's `ur_rtde`; runs in an environment of its own.

Prints one line of JSON: figure -> value. Call: `python ur_rtde_client.py ADDRESS CONTROL_PORT`.
"""

import itertools
import json
import socket
import sys
import time

import dashboard_client
import rtde_control
import rtde_receive

SPEED = (0.1, -0.05, 0.08, 0.02, -0.1, 0.05)


def fault(address, port, line):
    """One line to the emulator's control port; its answer."""
    with socket.create_connection((address, port), timeout=5.0) as control:
        control.sendall(f"{line}\n".encode())
        return control.makefile().readline().strip()


def stream(receive, control, seconds, command):
    """Send a command per cycle; rows of time, actual and target joint positions."""
    rows = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        started = control.initPeriod()
        command()
        rows.append((receive.getTimestamp(), receive.getActualQ(), receive.getTargetQ()))
        control.waitPeriod(started)
    return rows


def speed(receive, control):
    """`speedJ`: steady velocity and the way from start to rest."""
    rows = stream(receive, control, 1.0, lambda: control.speedJ(list(SPEED), 10.0, 0.002))
    late = [row for row in rows if row[0] > rows[0][0] + 0.5]
    span = late[-1][0] - late[0][0]
    rates = [(b - a) / span for a, b in zip(late[0][1], late[-1][1], strict=True)]
    control.speedStop(10.0)
    return max(abs(rate - wanted) for rate, wanted in zip(rates, SPEED, strict=True))


def servo(receive, control):
    """`servoJ` along a ramp: how late the joints are [s]."""
    start, rate = receive.getActualQ(), 0.1
    begin = receive.getTimestamp()
    lates = []
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        started = control.initPeriod()
        now = receive.getTimestamp() - begin
        control.servoJ([start[0] + rate * now, *start[1:]], 0.0, 0.0, 0.002, 0.03, 300)
        if now > 0.5:
            lates.append(now - (receive.getActualQ()[0] - start[0]) / rate)
        control.waitPeriod(started)
    control.servoStop()
    return sorted(lates)[len(lates) // 2]


def move(receive, control):
    """`moveJ`: distance to the goal [rad]."""
    goal = [q + 0.2 for q in receive.getActualQ()]
    control.moveJ(goal, 1.0, 2.0)
    time.sleep(0.1)
    return max(abs(a - b) for a, b in zip(receive.getActualQ(), goal, strict=True))


def custom(receive, control):
    """A script of one's own: distance to its goal [rad]."""
    goal = receive.getActualQ()
    goal[5] -= 0.3
    control.sendCustomScriptFunction("turn", f"movej({goal}, a=2.0, v=1.0)\n")
    time.sleep(0.2)
    return max(abs(a - b) for a, b in zip(receive.getActualQ(), goal, strict=True))


def refused(action):
    """Whether a call fails, by its answer or by an exception."""
    try:
        return action() is False
    except RuntimeError:
        return True


def stop_and_unlock(address, port, receive, control, dashboard):
    """A protective stop during a motion; what the client sees of it."""
    seen = {}
    for _ in range(100):
        control.speedJ([0.2, 0, 0, 0, 0, 0], 5.0, 0.0)
        time.sleep(0.002)
    seen["answer"] = fault(address, port, "protective_stop")
    time.sleep(0.3)
    seen["stopped"] = receive.isProtectiveStopped()
    seen["safety"] = dashboard.safetystatus()
    before = receive.getActualQ()
    seen["early"] = refused(dashboard.unlockProtectiveStop)
    seen["still_stopped"] = receive.isProtectiveStopped()
    time.sleep(5.2)
    seen["late"] = refused(dashboard.unlockProtectiveStop)
    time.sleep(0.3)
    seen["unlocked"] = not receive.isProtectiveStopped()
    seen["moved"] = max(abs(a - b) for a, b in zip(receive.getActualQ(), before, strict=True))
    # The inputs still hold the last speedJ: the arm goes on as soon as the script runs again.
    seen["again"] = control.reuploadScript()
    while not control.isProgramRunning():
        time.sleep(0.01)
    control.speedStop(5.0)
    seen["move_error"] = move(receive, control)
    return seen


def main():
    """Connect, move, stop; print the figures."""
    address, port = sys.argv[1], int(sys.argv[2])
    dashboard = dashboard_client.DashboardClient(address)
    dashboard.connect()
    receive = rtde_receive.RTDEReceiveInterface(address)
    control = rtde_control.RTDEControlInterface(address)
    stamps = []
    while len(stamps) < 200:
        if not stamps or receive.getTimestamp() != stamps[-1]:
            stamps.append(receive.getTimestamp())
        time.sleep(0.0002)
    found = {
        "robot": dashboard.robotmode(),
        "model": str(dashboard.getRobotModel()),
        "serial": dashboard.getSerialNumber(),
        "version": dashboard.polyscopeVersion(),
        "remote": dashboard.isInRemoteControl(),
        "mode": receive.getRobotMode(),
        "safety": receive.getSafetyMode(),
        "pose": receive.getActualTCPPose(),
        "cycle": min(b - a for a, b in itertools.pairwise(stamps)),
        "speed_error": speed(receive, control),
        "servo_late": servo(receive, control),
        "move_error": move(receive, control),
        "custom_error": custom(receive, control),
        "stop": stop_and_unlock(address, port, receive, control, dashboard),
    }
    control.stopScript()
    print(json.dumps(found))


main()
