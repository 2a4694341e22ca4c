"""A drive from its port to its state: connect, home, one exchange in every cycle. No ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from surg_hardware.drive import drive_checkup
from surg_hardware.drive.drive_file import DriveFile
from surg_hardware.drive.dynamixel_bus import DynamixelBus
from surg_hardware.drive.instrument_drive import DriveState, InstrumentDrive
from surg_hardware.drive.motor_values import DriveFailed, Failure
from surg_hardware.drive.serial_port import GONE, SerialPort

PERIOD = 0.01
"""[s] Of a cycle."""


class DriveSession:
    """One drive.

    Args:
        drive: Its file.
        open_port: Opens its port, for the SDK.
        clock: [s].

    Attributes:
        joints: Their names, in the order of the status.
        core: Its state.
        bus: Its motors; None: not connected.
    """

    def __init__(
        self,
        drive: DriveFile,
        open_port: Callable[[], Any] | None = None,
        clock: Callable[[], float] | None = None,
    ) -> None:
        self._drive, self._clock = drive, clock or time.monotonic
        self.joints = drive.joints
        self._open = open_port or (lambda: SerialPort(drive.port, drive.baud))
        self.core = InstrumentDrive(drive)
        self.bus: DynamixelBus | None = None

    def connect(self) -> None:
        """Open the port and identify the motors; nothing turns. What is wrong is in the status."""
        self.close()
        try:
            self.bus = DynamixelBus(self._drive, self._open())
            found = drive_checkup.motor_findings(self._drive, self.bus)
            if wrong := [each for each in found if each.good is False]:
                self.core.disconnected("; ".join(map(str, wrong)))
                self.close()
                return
            self.bus.prepare()
        except DriveFailed as error:
            self.core.fail(error)
        except GONE:
            self.core.disconnected(drive_checkup.port_finding(self._drive).text)
            self.close()
        else:
            self.core.identified(self._clock())

    def home(self) -> None:
        """Connect anew, which forgets a failure, and seek the stops: a person has confirmed it."""
        self.connect()
        self.core.home()

    def cycle(self, goal: Mapping[str, float] | None = None) -> None:
        """Give a goal of joints [rad] and exchange once with the motors, if they are connected."""
        if goal is not None:
            self.core.command(goal)
        if self.bus is None:
            return
        try:
            readings = self.bus.exchange(self.core.orders)
            self.core.step(self._clock(), readings)
        except DriveFailed as error:
            if self.core.status.state is not DriveState.FAILED:
                self.core.fail(error)
        except GONE as error:
            self.core.fail(DriveFailed(Failure.UNPLUGGED, detail=str(error)))
            self.close()

    def close(self) -> None:
        """Leave the port; motors that hold go on holding."""
        if self.bus is not None:
            self.bus.close()
            self.bus = None
