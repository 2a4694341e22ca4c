"""Judges what the motors say: silence, hardware errors, voltage, temperature, stalls."""

from __future__ import annotations

from collections.abc import Mapping

from surg_hardware.drive.drive_file import DriveFile
from surg_hardware.drive.motor_values import (
    ERROR_BITS,
    DriveFailed,
    Failure,
    MotorOrder,
    MotorReading,
)

SILENCE, MISSED = 0.1, 4
"""[s] and questions without an answer of a motor: its packets are lost, or it is unplugged. One
question alone may have waited for this machine."""
OFF_GOAL, STILL = 0.1, 0.05
"""[rad] of the encoder from its goal, [rad/s] below which it does not move: it stalls."""
STALLED = 0.05
"""[s] For so long: with the 0.11 s in which the arm stops less than 0.25 s, at 1.3 rad/s."""


class MotorGuard:
    """Remembers when each motor answered, and since when it stalls."""

    def __init__(self, drive: DriveFile) -> None:
        self._drive = drive
        self._heard: dict[int, float] = {}
        self._missed: dict[int, int] = {}
        self._stalls: dict[int, float] = {}

    def begin(self, now: float) -> None:
        """Count from now on [s]."""
        self._heard = dict.fromkeys([motor.id for motor in self._drive.motors], now)
        self._missed = dict.fromkeys(self._heard, 0)
        self._stalls.clear()

    def check(self, now: float, readings: Mapping[int, MotorReading]) -> None:
        """Judge a cycle's answers.

        Args:
            now: [s].
            readings: Id of each motor that has answered -> what it said.

        Raises:
            DriveFailed: With the first thing that is wrong.
        """
        for motor_id, reading in readings.items():
            self._heard[motor_id], self._missed[motor_id] = now, -1
            self._check_reading(motor_id, reading)
        for motor_id in self._missed:
            self._missed[motor_id] += 1
        if silent := [motor_id for motor_id in self._heard if self._is_silent(motor_id, now)]:
            everything = len(silent) == len(self._heard)
            raise DriveFailed(Failure.SILENT, None if everything else silent[0])

    def _is_silent(self, motor_id: int, now: float) -> bool:
        return self._missed[motor_id] >= MISSED and now - self._heard[motor_id] > SILENCE

    def check_motion(
        self,
        now: float,
        readings: Mapping[int, MotorReading],
        orders: Mapping[int, MotorOrder],
        gripping: int | None = None,
    ) -> None:
        """Look for motors that are told to move and stand still.

        Args:
            now: [s].
            readings: By the motors' ids.
            orders: Those of the cycle before, likewise.
            gripping: Id of the motor that closes the jaws: it may stand still at its current.

        Raises:
            DriveFailed: One does.
        """
        for motor_id, order in orders.items():
            reading = readings.get(motor_id)
            if reading is None:
                continue
            off = abs(order.position - reading.position)
            if off < OFF_GOAL or abs(reading.velocity) > STILL or motor_id == gripping:
                self._stalls.pop(motor_id, None)
            elif now - self._stalls.setdefault(motor_id, now) > STALLED:
                raise DriveFailed(Failure.STALL, motor_id, f"{off:.2f} rad from its goal")

    def _check_reading(self, motor_id: int, reading: MotorReading) -> None:
        for bit, failure in ERROR_BITS.items():
            if reading.error & bit:
                raise DriveFailed(failure, motor_id, "its own protection has switched it off")
        if reading.holds:
            raise DriveFailed(Failure.LATE, motor_id)
        low, high = self._drive.voltage
        if not low <= reading.voltage <= high:
            text = f"{reading.voltage:.1f} V; allowed: {low:g} to {high:g} V"
            raise DriveFailed(Failure.VOLTAGE, motor_id, text)
        hottest = self._drive.temperature
        if reading.temperature > hottest:
            text = f"{reading.temperature:g} degC; allowed: {hottest:g}"
            raise DriveFailed(Failure.OVERHEAT, motor_id, text)
