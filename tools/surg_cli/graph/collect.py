"""Records an arm's joint states at standstill into a recording for `./surg calibrate`."""

from __future__ import annotations

import argparse
import contextlib
import queue
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from surg_cli.graph import master
from surg_cli.host.terminal import CliError, say
from surg_core.standstill import Standstill

TIMEOUT_S = 600.0
"""Longest wait for a pose or a view [s]."""


def collect(arm: Any, to: Path, motion: str, count: int, options: argparse.Namespace) -> int:
    """Append one row of joint angles to a recording whenever the arm has come to rest anew.

    ``motion`` is the first column of the rows; a real or emulated arm's serial is the second one.
    ``options`` has the `port` of the ROS master.

    Raises:
        CliError: The file has other columns, no system runs, or the arm does not come to rest.
    """
    names = list(arm.robot.joint_names)
    # The link drives no arm but the one with the cell's serial.
    serial = [] if arm.hardware is None else [arm.hardware.serial]
    header = ",".join(["motion", *(["serial"] if serial else []), *names])
    check_columns(to, header)
    with system_at(options.port):
        say(f"{count} poses of '{motion}' -> {to}; hold the arm still for 0.5 s in each")
        for q in rests(arm, to, count, TIMEOUT_S):
            append(to, header, ",".join([motion, *serial, *(f"{value:.9f}" for value in q)]))
    return 0


@contextlib.contextmanager
def system_at(port: int, name: str = "surg_calibrate", anonymous: bool = True) -> Iterator[None]:
    """Be a node of the running system on this port while the context lasts.

    Raises:
        CliError: No system runs.
    """
    uri = f"http://localhost:{port}"
    master.nodes(uri)
    with master.joined(uri, name, anonymous):
        yield


def rests(arm: Any, to: Path, count: int, timeout: float) -> Iterator[np.ndarray]:
    """Joint angles [rad] of an arm each time that it has come to rest anew.

    Raises:
        CliError: No rest within ``timeout`` [s]; says how many rows ``to`` has got.
    """
    import rospy
    from sensor_msgs.msg import JointState

    from surg_ros.joint_order import positions_of

    names = list(arm.robot.joint_names)
    found: queue.Queue[np.ndarray] = queue.Queue()
    standstill = Standstill()

    def hear(message: Any) -> None:
        q = positions_of(message, names)
        if len(q) == len(names) and message.header.stamp.to_nsec() > 0:
            rest = standstill.add(message.header.stamp.to_sec(), np.array(q))
            if rest is not None:
                found.put(rest)

    topic = f"/{arm.name}/robot/measured_js"
    listener = rospy.Subscriber(topic, JointState, hear, queue_size=1000, tcp_nodelay=True)
    try:
        for done in range(count):
            try:
                q = found.get(timeout=timeout)
            except queue.Empty:
                raise CliError(
                    f"no new standstill on {topic} within {timeout:g} s; "
                    f"{done} of {count} are in {to}"
                ) from None
            yield q
            say(f"  {done + 1} of {count}")
    finally:
        listener.unregister()


def append(to: Path, header: str, line: str) -> None:
    """Write a row, after the header where the file is new."""
    with to.open("a", encoding="utf-8") as file:
        file.write(f"{line}\n" if file.tell() else f"{header}\n{line}\n")


def check_columns(to: Path, header: str) -> None:
    """Refuse an existing file with other columns, and a file in no folder.

    Raises:
        CliError: With the columns.
    """
    if not to.exists():
        if not to.parent.is_dir():
            raise CliError(f"--to {to}: no folder {to.parent}", 2)
        return
    lines = [line for line in to.read_text(encoding="utf-8").splitlines() if line[:1] != "#"]
    if lines and lines[0] != header:
        raise CliError(f"--to {to}: its header is {lines[0]}; expected {header}", 2)
