"""The motors of a drive on their bus, by the maker's SDK: one write and one read in a cycle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from dynamixel_easy_sdk.control_table import ControlTable
from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, GroupSyncWrite
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

from surg_hardware.drive.drive_file import MODELS, DriveFile
from surg_hardware.drive.motor_values import DriveFailed, Failure, MotorOrder, MotorReading

TURN = 4096
"""Steps of an encoder in one turn."""
RAD, RAD_S = 2 * math.pi / TURN, 0.229 * 2 * math.pi / 60
"""[rad], [rad/s] of one step of position and of velocity."""
AMPERE, VOLT = 2.69e-3, 0.1
"""[A], [V] of one step of current and of voltage."""
CURRENT_BASED_POSITION = 5
"""Operating mode."""
WATCHDOG, TRIPPED = 10, 0xFF
"""[20 ms] Without an instruction, after which a motor stops and holds by itself; it has done so."""
ALERT = 0x80
"""Bit of a status packet: the motor has a hardware error."""
ALL_ANSWER = 2
"""Status return level."""
TRIES = 10
"""Of what must be answered, 8 ms each: a line may lose a packet, a busy machine some."""
REBOOT_TRIES = 12
"""Rounds of pings after which a motor that starts again answers."""

_TABLE = ControlTable.getControlTable(MODELS["XM430-W350"].number)
"""Name -> address and size by the maker's file; the models of `MODELS` share what is used here."""
_READ = ("Hardware Error Status", "Present Temperature")
_WRITTEN = ("Goal Current", "Goal Position")


class DynamixelBus:
    """The motors of a file on an open port.

    Args:
        drive: The file.
        port: Of the SDK.

    Attributes:
        lost: Answers that did not come, or that were damaged, since the start.
        asked: Answers that were asked for.
    """

    def __init__(self, drive: DriveFile, port: Any) -> None:
        self._drive, self._port = drive, port
        self._ids = [motor.id for motor in drive.motors]
        self._handler = Protocol2PacketHandler()
        self._first, self._read_size = _block(*_READ)
        first, size = _block(*_WRITTEN)
        self._goals = GroupSyncWrite(port, self._handler, first, size)
        self._on: set[int] = set()  # motors whose torque is on
        self.lost = self.asked = 0

    def close(self) -> None:
        """Close the port; motors that hold go on holding."""
        self._port.closePort()

    def ping(self, motor_id: int) -> int | None:
        """Number of the model of a motor; None: it does not answer."""
        for _ in range(TRIES):
            model, result, _ = self._handler.ping(self._port, motor_id)
            if result == COMM_SUCCESS:
                return int(model)
        return None

    def scan(self) -> dict[int, int]:
        """Id -> number of the model of every motor that answers at this baud; takes a second."""
        found, _ = self._handler.broadcastPing(self._port)
        return {int(motor_id): int(values[0]) for motor_id, values in found.items()}

    def prepare(self) -> None:
        """Bring every motor to the mode it is driven in, with its torque off.

        Raises:
            DriveFailed: A motor does not answer, or refuses a value.
        """
        for motor in self._drive.motors:
            if self._ask(motor.id, "Hardware Error Status"):
                self._handler.reboot(self._port, motor.id)
                any(self.ping(motor.id) is not None for _ in range(REBOOT_TRIES))
            self.write(motor.id, "Status Return Level", ALL_ANSWER)
            self.write(motor.id, "Torque Enable", 0)
            self.write(motor.id, "Bus Watchdog", 0)
            for name, value in (
                ("Operating Mode", CURRENT_BASED_POSITION),
                ("Return Delay Time", 0),
                ("Current Limit", _steps(motor.current)),
            ):
                if self._ask(motor.id, name) != value:  # these wear: they stand in an EEPROM
                    self.write(motor.id, name, value)
        self._on.clear()

    def exchange(self, orders: Mapping[int, MotorOrder]) -> dict[int, MotorReading]:
        """Send the orders and ask all motors; returns the answers that came.

        Raises:
            DriveFailed: A motor does not switch its torque.
            OSError: The port is gone.
        """
        self._switch(orders)
        self._goals.clearParam()
        for motor_id, order in orders.items():
            self._goals.addParam(motor_id, _goal_bytes(order))
        if orders:
            self._goals.txPacket()
        return self._read()

    def write(self, motor_id: int, name: str, value: int) -> None:
        """Write a value of the control table.

        Raises:
            DriveFailed: The motor does not answer, or refuses it.
        """
        item = _TABLE[name]
        data = list(value.to_bytes(item.size, "little", signed=value < 0))
        for _ in range(TRIES):
            result, error = self._handler.writeTxRx(
                self._port, motor_id, item.address, item.size, data
            )
            if result == COMM_SUCCESS:
                break
        self._check(motor_id, f"{name} = {value}", result, error)

    def _switch(self, orders: Iterable[int]) -> None:
        """Torque on where there is an order, off elsewhere."""
        failed: DriveFailed | None = None
        for motor_id in self._on - set(orders):
            try:
                self.write(motor_id, "Torque Enable", 0)
                self._on.discard(motor_id)
            except DriveFailed as error:  # the others must turn freely all the same
                failed = error
        if failed is not None:
            raise failed
        for motor_id in set(orders) - self._on:
            self.write(motor_id, "Torque Enable", 1)
            self.write(motor_id, "Bus Watchdog", WATCHDOG)
            self._on.add(motor_id)

    def _read(self) -> dict[int, MotorReading]:
        """One sync read; the answers are sorted by their ids, so that a lost one hides no other."""
        n = len(self._ids)
        self._handler.syncReadTx(self._port, self._first, self._read_size, self._ids, n, False)
        found: dict[int, MotorReading] = {}
        for _ in range(n):
            packet, result = self._handler.rxPacket(self._port, False)
            # Behind FF FF FD, the SDK takes a byte out of FF FD FD: the length tells.
            whole = result == COMM_SUCCESS and packet[5] | packet[6] << 8 == self._read_size + 4
            if whole and packet[4] in self._ids:
                found[packet[4]] = _reading(bytes(packet[9 : 9 + self._read_size]), self._first)
            if result == COMM_RX_TIMEOUT:
                break
        self.asked += n
        self.lost += n - len(found)
        return found

    def _ask(self, motor_id: int, name: str) -> int:
        item = _TABLE[name]
        for _ in range(TRIES):
            data, result, error = self._handler.readTxRx(
                self._port, motor_id, item.address, item.size
            )
            if result == COMM_SUCCESS:
                break
        self._check(motor_id, name, result, error)
        return int.from_bytes(bytes(data), "little")

    def _check(self, motor_id: int, what: str, result: int, error: int) -> None:
        if result != COMM_SUCCESS:
            raise DriveFailed(Failure.SILENT, motor_id, what)
        if error & ~ALERT:
            words = self._handler.getRxPacketError(error & ~ALERT)
            raise DriveFailed(Failure.REFUSED, motor_id, f"{what}: {words}")


def _block(first: str, last: str) -> tuple[int, int]:
    """Address and size of the part of the table from one value to another."""
    start, end = _TABLE[first], _TABLE[last]
    return start.address, end.address + end.size - start.address


def _steps(current: float) -> int:
    return round(current / AMPERE)


def _goal_bytes(order: MotorOrder) -> list[int]:
    """Goal current, goal velocity (not used), acceleration (0: all), velocity and position."""
    fields = (
        (_steps(order.current), 2),
        (0, 4),
        (0, 4),
        (max(round(order.velocity / RAD_S), 1), 4),
        (round(order.position / RAD), 4),
    )
    return [byte for value, n in fields for byte in value.to_bytes(n, "little", signed=True)]


def _reading(data: bytes, first: int) -> MotorReading:
    def value(name: str, signed: bool = True) -> int:
        item = _TABLE[name]
        start = item.address - first
        return int.from_bytes(data[start : start + item.size], "little", signed=signed)

    return MotorReading(
        position=RAD * value("Present Position"),
        velocity=RAD_S * value("Present Velocity"),
        current=AMPERE * value("Present Current"),
        voltage=VOLT * value("Present Input Voltage", signed=False),
        temperature=float(value("Present Temperature", signed=False)),
        error=value("Hardware Error Status", signed=False),
        holds=value("Bus Watchdog", signed=False) == TRIPPED,
    )
