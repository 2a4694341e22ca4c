"""The node of an instrument's drive: goals and angles on topics, motors on a serial port.

Parameters: ``~cell`` (folder or cell.yaml), ``~arm``. Exit code 2: cell or drive file must not be
used. A drive that is not homed, or that has failed, says no angle: the controller then holds the
arm (F31), and the warning names motor and cause.
"""

from __future__ import annotations

import gc
import math
import sys
import time
from dataclasses import dataclass
from typing import Any

import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import surg_core
from crtk_msgs.msg import OperatingState, StringStamped
from surg_hardware.drive.drive_file import DriveFile, drive_of
from surg_hardware.drive.drive_session import PERIOD, DriveSession
from surg_hardware.drive.instrument_drive import DriveState
from surg_ros.params import read, text
from surg_ros.real_time import prefer

AGAIN = 2.0
"""[s] Between two looks for a drive that is not there."""


@dataclass(frozen=True)
class Settings:
    """Parameters of the node."""

    cell: str = text()
    arm: str = text()


class DriveNode:
    """One drive on topics."""

    def __init__(self, drive: DriveFile, arm: str, cell: str) -> None:
        self._session = DriveSession(drive)
        self._arm, self._cell, self._joints = arm, cell, list(drive.joints)
        self._goal: dict[str, float] | None = None
        self._request = ""
        self._enabled = False
        self._said = ""
        root = f"/{arm}"
        self._measured = rospy.Publisher(f"{root}/tool/measured_js", JointState, queue_size=2)
        self._status = rospy.Publisher(
            f"{root}/tool/status", StringStamped, queue_size=2, latch=True
        )
        self._warning = rospy.Publisher(f"{root}/warning", String, queue_size=10)
        keys: dict[str, Any] = {"queue_size": 1, "tcp_nodelay": True}
        rospy.Subscriber(f"{root}/tool/servo_jp", JointState, self._on_goal, **keys)
        rospy.Subscriber(f"{root}/tool/request", StringStamped, self._on_request, **keys)
        rospy.Subscriber(f"{root}/operating_state", OperatingState, self._on_state, **keys)

    def run(self) -> None:
        """Serve until shutdown."""
        tried = -math.inf
        while not rospy.is_shutdown():
            begun = time.monotonic()
            if self._session.core.status.state is DriveState.DISCONNECTED and begun - tried > AGAIN:
                self._session.connect()
                tried = time.monotonic()
            self._obey()
            self._session.cycle(self._goal)
            self._tell()
            time.sleep(max(PERIOD - (time.monotonic() - begun), 0.0))
        self._session.close()

    def _obey(self) -> None:
        """Do what was requested; never while the arm is ENABLED: the instrument turns."""
        request, self._request = self._request, ""
        if not request:
            return
        if request != "home":
            self._warn(f"tool/request {request!r}: allowed: home")
        elif self._enabled:
            self._warn("home: refused while the arm is ENABLED: disable it first")
        else:
            self._goal = None  # of before
            self._session.home()

    def _tell(self) -> None:
        """Publish the angles, if they are known, and the status when it has changed."""
        status = self._session.core.status
        message = JointState(name=self._joints)
        if status.q:
            message.header.stamp = rospy.Time.from_sec(time.time())
            message.position, message.velocity = list(status.q), list(status.qd)
            self._measured.publish(message)
        said = status.text.replace("robot CELL", f"robot {self._cell}")
        if said == self._said:
            return
        self._said = said
        stamped = StringStamped(string=said)
        stamped.header.stamp = rospy.Time.from_sec(time.time())
        self._status.publish(stamped)
        if status.state is DriveState.FAILED:
            self._measured.publish(message)  # CRTK: stamp 0, not valid
        if status.state in (DriveState.FAILED, DriveState.DISCONNECTED):
            self._warn(said)

    def _on_goal(self, message: Any) -> None:
        names = list(message.name) or ["jaw"]
        if len(names) == len(message.position):
            self._goal = dict(zip(names, message.position, strict=True))

    def _on_request(self, message: Any) -> None:
        self._request = str(message.string)

    def _on_state(self, message: Any) -> None:
        self._enabled = message.state == "ENABLED"

    def _warn(self, sentence: str) -> None:
        rospy.logwarn(f"{self._arm}: drive: {sentence}")
        self._warning.publish(String(f"{self._arm}: drive: {sentence}"))


def main() -> int:
    """Entry point; returns the exit code."""
    rospy.init_node("drive")
    sys.setswitchinterval(1e-4)  # goals arrive on a thread of their own
    try:
        settings = read(Settings, rospy.get_param("~", {}))
        cell = surg_core.load_cell(settings.cell)
        if settings.arm not in cell.arms:
            raise ValueError(f"~arm {settings.arm!r}; allowed: {', '.join(cell.arms)}")
        drive = drive_of(cell, settings.arm)
        hardware = cell.arms[settings.arm].hardware
        if hardware is not None:
            # motors that hear nothing for 0.2 s hold
            prefer(hardware.realtime)
        node = DriveNode(drive, settings.arm, cell.folder.name)
    except (ValueError, OSError) as error:
        print(f"surg_hardware drive_node: {error}", file=sys.stderr)
        return 2
    gc.freeze()  # a collection of all that was imported would hold the motors up
    node.run()
    return 0
