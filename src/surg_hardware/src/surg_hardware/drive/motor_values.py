"""What a motor says, what it is told, and how a motor fails."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


@dataclass(frozen=True)
class MotorReading:
    """One answer of a motor.

    Attributes:
        position: Of its encoder [rad].
        velocity: [rad/s].
        current: [A].
        voltage: At its input [V].
        temperature: [degC].
        error: Bits of its hardware error, 0: none.
        holds: Whether its watchdog has stopped it: it takes no goals.
    """

    position: float
    velocity: float
    current: float
    voltage: float
    temperature: float
    error: int = 0
    holds: bool = False


@dataclass(frozen=True)
class MotorOrder:
    """Goal of an encoder [rad], bound of the current [A], largest velocity [rad/s].

    A motor without an order turns freely.
    """

    position: float
    current: float
    velocity: float


class Failure(StrEnum):
    """Why a drive has failed, in the words of its sentence."""

    UNPLUGGED = "the serial port is gone"
    SILENT = "does not answer"
    REFUSED = "refuses a value"
    LATE = "has heard nothing for 0.2 s and holds: this machine was too busy, or the line was cut"
    OVERLOAD = "over-load"
    SHOCK = "electrical shock, or too little power"
    ENCODER = "its encoder has failed"
    OVERHEAT = "over-heat"
    VOLTAGE = "voltage out of range"
    STALL = "does not turn"
    NO_STOP = "finds no stop"


ERROR_BITS = {
    0x20: Failure.OVERLOAD,
    0x10: Failure.SHOCK,
    0x08: Failure.ENCODER,
    0x04: Failure.OVERHEAT,
    0x01: Failure.VOLTAGE,
}
"""Bit of the hardware error -> its meaning, by the maker's table."""


class DriveFailed(Exception):
    """The drive has failed: how, which motor (None: all of them), and the measured value."""

    def __init__(self, failure: Failure, motor: int | None = None, detail: str = "") -> None:
        super().__init__(failure, motor, detail)
        self.failure, self.motor, self.detail = failure, motor, detail
