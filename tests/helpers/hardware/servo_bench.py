"""An instrument's drive on emulated servos, through the maker's SDK, in simulated time."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from dynamixel_sdk.port_handler import PortHandler

from surg_cli.host import paths
from surg_emulators.drive.servo_line import ServoLine
from surg_emulators.drive.servo_motor import Servo
from surg_hardware.drive.drive_file import DriveFile, load_drive
from surg_hardware.drive.drive_session import PERIOD, DriveSession
from surg_hardware.drive.dynamixel_bus import DynamixelBus
from surg_hardware.drive.instrument_drive import DriveState

LOOK = 0.0002
"""[s] Between two looks at a silent line."""
MOTOR = {
    "id": 1, "model": "XM430-W350", "sign": 1, "gear": 1.0, "limits": [-1.4, 1.4], "velocity": 4.0,
    "current": 0.6, "homing": {"direction": -1, "current": 0.2, "stop": -0.3, "travel": 2.0},
}  # fmt: skip
JAW: dict[str, object] = {
    **MOTOR, "id": 3, "sign": -1, "gear": 1.5, "limits": [0.0, 1.0], "current": 0.4,
    "homing": {"direction": -1, "current": 0.15, "stop": -0.2, "travel": 2.0},
}  # fmt: skip
DRIVE: dict[str, Any] = {
    "format": "surg_drive/1", "port": "emulated", "baud": 1000000, "when_lost": "hold",
    "voltage": [11.0, 13.0], "temperature": 65,
    "motors": {"pitch": MOTOR, "yaw": {**MOTOR, "id": 2}, "jaw": JAW},
    "coupling": {"pitch": [1, 0, 0], "yaw": [0.6, 1, 0], "jaw": [0.2, -0.4, 1]},
}  # fmt: skip
"""A wrist whose pitch turns yaw and jaws too."""
OFFSETS = {1: 2.0, 2: -1.0, 3: 5.5}
"""Encoder where the motor is at zero, by its id [rad]."""


def drive_file(folder: Path, document: Mapping[str, Any] = DRIVE) -> DriveFile:
    """The drive of a document, from a file."""
    path = folder / "drive_PSM1.yaml"
    path.write_text(json.dumps(document, indent=1), "utf-8")  # JSON is YAML
    return load_drive(path)


def servos(lag: float = 0.04) -> list[Servo]:
    """The instrument's servos, near their stops."""
    found = []
    for motor_id, offset in OFFSETS.items():
        motor = JAW if motor_id == 3 else MOTOR
        way = float(motor["sign"]) * float(motor["gear"])  # type: ignore[arg-type]
        begin = offset + way * (motor["homing"]["stop"] + 0.05)  # type: ignore[index]
        ends = sorted((offset + way * motor["homing"]["stop"], offset + way * 1.9))  # type: ignore[index]
        found.append(Servo(motor_id, 1_000_000, begin, (ends[0], ends[1]), lag))
    return found


class MemoryPort(PortHandler):  # type: ignore[misc]
    """A line as the SDK's port; its clock goes on while bytes travel and while nobody answers."""

    def __init__(self, line: ServoLine, baud: int = 1_000_000) -> None:
        super().__init__("memory")
        self.line, self.time, self.unplugged = line, line.now, False
        self.setBaudRate(baud)
        self._coming: list[tuple[float, bytes]] = []
        self._here = b""

    def setupPort(self, cflag_baud: int) -> bool:
        """There is nothing to open."""
        self.tx_time_per_byte = 1e4 / self.baudrate
        return True

    def closePort(self) -> None:
        """There is nothing to close."""

    def clearPort(self) -> None:
        """Forget what has come."""
        self._here = b""

    def setPacketTimeout(self, packet_length: int) -> None:
        """As `SerialPort`."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + 8.0)

    def getCurrentTime(self) -> float:
        """[ms]."""
        return 1e3 * self.time

    def wait(self, until: float) -> None:
        """Let time pass [s]."""
        self.time = max(self.time, until)
        self.line.step(self.time)

    def writePort(self, packet: list[int]) -> int:
        """Send; takes its time on the line."""
        if self.unplugged:
            raise OSError("unplugged")
        sent = 1e-3 * self.tx_time_per_byte * len(packet)
        self.wait(max(self.time, self.line.now) + sent)
        self._coming += self.line.receive(bytes(packet), self.time, self.baudrate)
        return len(packet)

    def readPort(self, length: int) -> bytes:
        """What has come; a look takes time where it is too little."""
        if self.unplugged:
            raise OSError("unplugged")
        arrived = [each for each in self._coming if each[0] <= self.time]
        self._coming = [each for each in self._coming if each[0] > self.time]
        self._here += b"".join(data for _, data in arrived)
        if len(self._here) < length:
            self.wait(self.time + LOOK)
        found, self._here = self._here[:length], self._here[length:]
        return found


class ServoBench:
    """A session with emulated servos; `cycle` is one cycle of the node."""

    def __init__(self, drive: DriveFile, motors: list[Servo] | None = None) -> None:
        self.line = ServoLine(motors or servos())
        self.port = MemoryPort(self.line, drive.baud)
        self.session = DriveSession(drive, lambda: self.port, lambda: self.port.time)
        self.core = self.session.core
        self.cycles = 0

    @property
    def bus(self) -> DynamixelBus:
        """Of the session, while it is connected."""
        assert self.session.bus is not None, self.core.status
        return self.session.bus

    def cycle(self) -> None:
        """Exchange with the motors and judge; then wait for the next cycle."""
        begun = self.port.time
        self.session.cycle()
        self.cycles += 1
        self.port.wait(begun + PERIOD)

    def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Cycle until something holds, or for a time [s]; whether it holds."""
        begun = self.port.time
        while not condition() and self.port.time - begun < seconds:
            self.cycle()
        return condition()

    def homed(self) -> None:
        """Connect and home."""
        self.session.home()
        self.until(lambda: self.core.status.state is not DriveState.HOMING, 60.0)
        assert self.core.status.state is DriveState.HOMED, self.core.status


def with_terminals() -> None:
    """Skip the test where the system has no pseudo-terminals."""
    try:
        ends = os.openpty()
    except OSError as error:
        pytest.skip(f"missing: a pseudo-terminal ({error}): is /dev/pts mounted?")
    for end in ends:
        os.close(end)


def emulated_drive_cell(folder: Path, document: Mapping[str, Any] = DRIVE) -> Path:
    """The emulated UR5e with a grasper that has a drive; returns the cell's folder."""
    cell = folder / "cells" / folder.name
    shutil.copytree(paths.CELLS / "emulated_ur5e", cell)
    (folder / "src").mkdir()
    (folder / "src" / "surg_description").symlink_to(paths.ROOT / "src" / "surg_description")
    file = cell / "cell.yaml"
    stated = yaml.safe_load(file.read_text("utf-8"))
    arm = stated["arms"]["PSM1"]
    arm["instrument"] = arm["instrument"].replace("grasper_fixed", "grasper")
    arm["hardware"]["tool_link"] = "drive"
    file.write_text(yaml.safe_dump(stated), "utf-8")
    drive_file(cell, document)
    return cell
