"""What is good and what is wrong about a drive: port, baud, models, ids. Turns nothing."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from surg_hardware.checkup import Finding
from surg_hardware.drive.drive_file import BAUDS, MODELS, DriveFile, Motor
from surg_hardware.drive.dynamixel_bus import DynamixelBus
from surg_hardware.drive.serial_port import GONE, SerialPort

FACTORY_BAUD = 57_600
"""[bit/s] Of a new motor."""
ROUNDS = 20
"""Exchanges by which a line is judged."""
POOR = 0.5
"""Share of lost answers above which two motors answer at once, or the line is bad."""
SLOWEST = 100.0
"""[1/s] Exchanges."""
SET_ID = "connect one motor at a time: ./surg robot CELL drive id"


def port_finding(drive: DriveFile) -> Finding:
    """Whether the port is there, is ours to use, and free."""
    port = drive.port
    if not port.exists():
        there = sorted(str(path) for path in Path("/dev").glob("tty[UA]*[MB]*"))
        text = f"{port}: no such port; there are: {', '.join(there) or 'none'}"
        cure = "start ./surg emulate CELL" if drive.emulated else "plug the adapter in"
        return Finding("drive port", text, False, cure)
    if not os.access(port, os.R_OK | os.W_OK):
        cure = "add this user to the group dialout, then log in again"
        return Finding("drive port", f"{port}: not allowed to this user", False, cure)
    try:
        SerialPort(port, drive.baud).closePort()
    except GONE as error:
        cure = "end the system or the program that has it"
        return Finding("drive port", f"{port}: cannot be opened: {error}", False, cure)
    return Finding("drive port", f"{port}")


def motor_findings(drive: DriveFile, bus: DynamixelBus) -> list[Finding]:
    """Whether every motor of the file answers, is of its model, and alone with its id."""
    found = []
    for motor in drive.motors:
        key, model = f"motors.{motor.joint}", bus.ping(motor.id)
        if model is None:
            text = f"motor {motor.id} does not answer at {drive.baud} bit/s"
            found.append(Finding(key, text, False, "check its cable and power"))
        elif model != MODELS[motor.model].number:
            text = f"motor {motor.id} is {model_name(model)}; the file says {motor.model}"
            found.append(Finding(f"{key}.model", text, False, f"correct {drive.file.name}"))
        else:
            found.append(Finding(key, f"motor {motor.id}, {motor.model}"))
    if all(each.good for each in found):
        found += _line_findings(drive, bus)
    return found


def examine(drive: DriveFile) -> list[Finding]:
    """Everything about a drive that no system has opened."""
    port = port_finding(drive)
    if not port.good:
        return [port]
    try:
        serial = SerialPort(drive.port, drive.baud)
        bus = DynamixelBus(drive, serial)
        found = [port, *motor_findings(drive, bus)]
        if any(each.good is False for each in found):
            silent = any(bus.ping(motor.id) is None for motor in drive.motors)
            bus.close()
            elsewhere = [hit for hit in scan(drive) if hit[0] != drive.baud] if silent else []
            return [*found, *(_elsewhere(drive, *hit) for hit in elsewhere)]
        begun = serial.getCurrentTime()
        readings = {k: v for _ in range(ROUNDS) for k, v in bus.exchange({}).items()}
        found.append(_rate(1e3 * ROUNDS / (serial.getCurrentTime() - begun)))
        bus.close()
    except GONE as error:
        return [Finding("drive port", f"{drive.port}: {error}", False, "plug it in again")]
    for motor_id, said in readings.items():
        text = f"{said.voltage:.1f} V, {said.temperature:g} degC, hardware error {said.error}"
        found.append(Finding(drive.name(motor_id), text, said.error == 0, "look for its cause"))
    return found


def scan(drive: DriveFile) -> Iterator[tuple[int, int, str]]:
    """Baud, id and model of every motor that answers at any baud; takes some seconds.

    Raises:
        OSError: The port cannot be opened.
    """
    for baud in (FACTORY_BAUD, *BAUDS):
        bus = DynamixelBus(drive, SerialPort(drive.port, baud))
        try:
            for motor_id, model in sorted(bus.scan().items()):
                yield baud, motor_id, model_name(model)
        finally:
            bus.close()


def set_id(drive: DriveFile, motor: Motor, baud: int, old: int) -> None:
    """Give the only motor on the line the id and the baud of the file.

    Raises:
        DriveFailed: It refuses.
        OSError: The port is gone.
    """
    bus = DynamixelBus(drive, SerialPort(drive.port, baud))
    try:
        bus.write(old, "Torque Enable", 0)
        bus.write(old, "ID", motor.id)
        bus.write(motor.id, "Baud Rate", BAUDS.index(drive.baud) + 3)
    finally:
        bus.close()


def model_name(number: int) -> str:
    """Of a model's number."""
    return next((n for n, model in MODELS.items() if model.number == number), f"model {number}")


def _line_findings(drive: DriveFile, bus: DynamixelBus) -> list[Finding]:
    counts = dict.fromkeys([motor.id for motor in drive.motors], 0)
    for _ in range(ROUNDS):
        for motor_id in bus.exchange({}):
            counts[motor_id] += 1
    poor = [i for i, n in counts.items() if n < (1 - POOR) * ROUNDS]
    if len(poor) == len(counts) > 1:
        text = "most answers are damaged or lost"
        return [Finding("drive line", text, False, "check cables, power and termination")]
    return [
        Finding("drive line", f"two motors answer as {i}, or its line is bad", False, SET_ID)
        for i in poor
    ]


def _elsewhere(drive: DriveFile, baud: int, motor_id: int, model: str) -> Finding:
    text = f"motor {motor_id} ({model}) answers at {baud} bit/s; the file says {drive.baud}"
    return Finding("baud", text, False, SET_ID)


def _rate(rate: float) -> Finding:
    text = f"{rate:.0f} exchanges per second"
    cure = "set latency_timer of the USB adapter to 1 ms (docs/guide/build_a_drive.md)"
    return Finding("drive line", text, rate >= SLOWEST, "" if rate >= SLOWEST else cure)
