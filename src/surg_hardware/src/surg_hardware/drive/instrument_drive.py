"""The state of an instrument's drive, whatever speaks with its motors.

Pure: answers of the motors, goals and the time go in, orders for the motors and a status come out.
Nothing turns before `InstrumentDrive.home`, which a person asks for. A failure latches until the
next homing, and says the motor and what is wrong with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from surg_core.checked_document import FloatArray
from surg_hardware.drive.coupling import Coupling
from surg_hardware.drive.drive_file import DriveFile
from surg_hardware.drive.homing import Homing
from surg_hardware.drive.motor_guard import MotorGuard
from surg_hardware.drive.motor_values import DriveFailed, Failure, MotorOrder, MotorReading

HOME = "./surg robot CELL drive home"


class DriveState(StrEnum):
    """What the drive does."""

    DISCONNECTED = "DISCONNECTED"
    IDENTIFIED = "IDENTIFIED"
    HOMING = "HOMING"
    HOMED = "HOMED"
    RUNNING = "RUNNING"
    FAILED = "FAILED"


@dataclass(frozen=True)
class DriveStatus:
    """State, sentence, and angles [rad] and velocities [rad/s] of the joints.

    They are empty in a cycle in which a motor has not answered: an old angle is never said again.
    """

    state: DriveState
    sentence: str
    q: tuple[float, ...] = ()
    qd: tuple[float, ...] = ()

    @property
    def text(self) -> str:
        """State and sentence in one line."""
        return f"{self.state}: {self.sentence}" if self.sentence else str(self.state)


class InstrumentDrive:
    """One drive; call `step` in every cycle.

    Attributes:
        status: What it does.
        orders: Newest orders by the motors' ids; a motor without one turns freely.
    """

    def __init__(self, drive: DriveFile) -> None:
        self._drive = drive
        self._guard = MotorGuard(drive)
        self._homing: Homing | None = None
        self._coupling: Coupling | None = None
        self._goal: FloatArray = np.zeros(len(drive.motors))
        self._q: FloatArray | None = None  # newest joints
        self._last: dict[int, MotorReading] = {}
        self.orders: dict[int, MotorOrder] = {}
        self.status = DriveStatus(DriveState.DISCONNECTED, "not connected yet")

    # --- events ---------------------------------------------------------------------------------

    def disconnected(self, why: str) -> None:
        """The port, or a motor of the file, is not there."""
        self._homing = self._coupling = None
        self.orders = {}
        self.status = DriveStatus(DriveState.DISCONNECTED, why)

    def identified(self, now: float) -> None:
        """The motors of the file answer, and obey nothing yet."""
        self._guard.begin(now)
        self._homing = self._coupling = self._q = None
        self._last, self.orders = {}, {}
        self.status = DriveStatus(DriveState.IDENTIFIED, f"not homed: {HOME}")

    def home(self) -> None:
        """Seek the stops; a person has confirmed that the instrument may move."""
        if self.status.state is DriveState.IDENTIFIED:
            self._homing = Homing(self._drive)
            self.status = DriveStatus(DriveState.HOMING, self._homing.sentence)

    def command(self, named: Mapping[str, float]) -> None:
        """Take goals of joints by name [rad]; before the end of homing nothing is taken."""
        if self._coupling is None or self.status.state is DriveState.FAILED:
            return
        self._goal = self._coupling.goal(self._goal, named)
        self.status = DriveStatus(DriveState.RUNNING, "", self.status.q, self.status.qd)

    def fail(self, error: DriveFailed) -> None:
        """Take a failure that the line has told; latches."""
        where = self._drive.name(error.motor) if error.motor is not None else "the motors"
        told = f"{where}: {error.failure}" + (f" ({error.detail})" if error.detail else "")
        if error.failure is Failure.UNPLUGGED:
            told = f"{error.failure} ({error.detail or self._drive.port})"
        self.orders = self._lost_orders()
        self.status = DriveStatus(DriveState.FAILED, f"{told}: mend it, then {HOME}")

    # --- the cycle ------------------------------------------------------------------------------

    def step(self, now: float, readings: Mapping[int, MotorReading]) -> None:
        """One cycle: judge, and renew status and orders.

        Args:
            now: [s].
            readings: Id of each motor that has answered -> what it said.
        """
        self._last.update(readings)
        if self.status.state not in (DriveState.DISCONNECTED, DriveState.FAILED):
            try:
                self._guard.check(now, readings)
                self.orders = self._move(now, readings)
            except DriveFailed as error:
                self.fail(error)

    def _move(self, now: float, readings: Mapping[int, MotorReading]) -> dict[int, MotorOrder]:
        if self._homing is not None:
            orders = self._homing.step(now, readings)
            self.status = DriveStatus(DriveState.HOMING, self._homing.sentence)
            if not self._homing.done:
                return orders
            self._coupling = Coupling(self._drive, self._homing.offsets)
            self._homing = None
            self._goal = np.zeros(len(self._drive.motors))
            self.status = DriveStatus(DriveState.HOMED, "")
        if self._coupling is None:
            return {}
        self._guard.check_motion(now, readings, self.orders, self._gripping())
        self.status = DriveStatus(self.status.state, "")
        if len(readings) == len(self._drive.motors):
            self._q = self._coupling.joints(self._values("position"))
            qd = self._coupling.rates(self._values("velocity"))
            told = tuple(self._q.tolist()), tuple(qd.tolist())
            self.status = DriveStatus(self.status.state, "", *told)
        return self._ordered(self._coupling.encoders(self._goal))

    def _gripping(self) -> int | None:
        """The jaw's motor, while the jaws are told to close further."""
        jaw = self._drive.joints.index("jaw")
        closes = self._q is not None and self._goal[jaw] < self._q[jaw]
        return self._drive.motors[jaw].id if closes else None

    def _lost_orders(self) -> dict[int, MotorOrder]:
        """What the motors that still obey do after a failure: hold, or open the jaws.

        Jaws that grip keep their goal, and with it their force.
        """
        if self._coupling is None or any(m.id not in self._last for m in self._drive.motors):
            return {}
        joints = self._coupling.joints(self._values("position"))
        if self._drive.when_lost == "open":
            joints = self._coupling.opened(joints)
        elif self._gripping() is not None:
            jaw = self._drive.joints.index("jaw")
            joints[jaw] = self._goal[jaw]
        return self._ordered(self._coupling.encoders(joints))

    def _ordered(self, encoders: FloatArray) -> dict[int, MotorOrder]:
        pairs = zip(self._drive.motors, encoders.tolist(), strict=True)
        return {
            motor.id: MotorOrder(goal, motor.current, motor.velocity * motor.gear)
            for motor, goal in pairs
            if math.isfinite(goal)
        }

    def _values(self, what: str) -> FloatArray:
        return np.array([getattr(self._last[motor.id], what) for motor in self._drive.motors])
