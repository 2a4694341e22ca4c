"""Homing: each motor in turn goes against its stop with a small current, then to its zero.

Pure: readings and the time go in, orders come out. Motors that are not homed yet turn freely.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

import numpy as np

from surg_core.checked_document import FloatArray
from surg_hardware.drive.drive_file import DriveFile, Motor
from surg_hardware.drive.motor_values import DriveFailed, Failure, MotorOrder, MotorReading

SPEED = 0.6
"""[rad/s] Of a motor behind its gear."""
LEAD = 0.25
"""[rad] By which the goal of an encoder leads it at a stop."""
STILL = 0.05
"""[rad/s] Below it an encoder does not move."""
AT_STOP = 0.15
"""[s] For so long."""
PUSHING = 0.5
"""Share of the homing current below which a motor that stands still is not at a stop."""
ARRIVED = 0.05
"""[rad] From its zero, at which an encoder has come back."""
PATIENCE = 3.0
"""[s] More than the way back takes."""


class _Phase(Enum):
    SEEK = 0
    RETURN = 1


class Homing:
    """Homes the motors of a drive one after the other.

    Attributes:
        offsets: (n,) encoders at the motors' zero [rad]; NaN: not known yet.
    """

    def __init__(self, drive: DriveFile) -> None:
        self._drive = drive
        self.offsets: FloatArray = np.full(len(drive.motors), np.nan)
        self._place = 0
        self._phase = _Phase.SEEK
        self._start: float | None = None  # encoder at the start of the phase [rad]
        self._since = 0.0  # start of the phase [s]
        self._still: float | None = None  # since when it stands still [s]

    @property
    def done(self) -> bool:
        """Whether every motor is at its zero."""
        return self._place == len(self._drive.motors)

    @property
    def sentence(self) -> str:
        """What happens now."""
        if self.done:
            return "homed"
        what = "seeks its stop" if self._phase is _Phase.SEEK else "returns to its zero"
        return f"the motor of {self._drive.motors[self._place].joint} {what}"

    def step(self, now: float, readings: Mapping[int, MotorReading]) -> dict[int, MotorOrder]:
        """One cycle; a motor that has not answered is waited for.

        Raises:
            DriveFailed: A motor finds no stop, or does not turn.
        """
        motors = self._drive.motors
        orders = {
            motor.id: MotorOrder(float(self.offsets[i]), motor.current, SPEED * motor.gear)
            for i, motor in enumerate(motors[: self._place])
        }
        if self.done:
            return orders
        motor = motors[self._place]
        reading = readings.get(motor.id)
        if reading is None:
            return orders
        if self._start is None:
            self._start, self._since, self._still = reading.position, now, None
        order = self._seek(motor, reading, now) if self._phase is _Phase.SEEK else None
        orders[motor.id] = order or self._return(motor, reading, now)
        return orders

    def _seek(self, motor: Motor, reading: MotorReading, now: float) -> MotorOrder | None:
        """Turn towards the stop; None: it is found."""
        assert self._start is not None
        homing, way = motor.homing, motor.sign * motor.homing.direction * motor.gear
        turned = abs(reading.position - self._start) / motor.gear
        goal = self._start + way * min(SPEED * (now - self._since), homing.travel)
        stands = abs(reading.velocity) < STILL and abs(goal - reading.position) > LEAD
        if not stands:
            self._still = None
        elif self._still is None:
            self._still = now
        elif now - self._still > AT_STOP:
            if abs(reading.current) < PUSHING * homing.current:
                raise DriveFailed(Failure.STALL, motor.id, "while it seeks its stop")
            zero = reading.position - motor.sign * motor.gear * homing.stop
            self.offsets[self._place] = zero
            self._phase, self._start, self._since = _Phase.RETURN, reading.position, now
            return None
        if turned > homing.travel - ARRIVED:
            raise DriveFailed(Failure.NO_STOP, motor.id, f"within {homing.travel:g} rad")
        return MotorOrder(goal, homing.current, SPEED * motor.gear)

    def _return(self, motor: Motor, reading: MotorReading, now: float) -> MotorOrder:
        zero = float(self.offsets[self._place])
        if abs(reading.position - zero) < ARRIVED:
            self._place += 1
            self._phase, self._start = _Phase.SEEK, None
        elif now - self._since > PATIENCE + abs(motor.homing.stop) / SPEED:
            raise DriveFailed(Failure.STALL, motor.id, "on the way back from its stop")
        return MotorOrder(zero, motor.homing.current, SPEED * motor.gear)
