"""What a robot's maker has to offer to be driven: a small class, `RobotAdapter`.

To connect an arm that the platform does not know, write a folder with ``driver.py`` and a class
``Driver`` in it that inherits from this one. `adapter_driver` runs it in a process of its own, with
dead-man, latch, last check and status of every link.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from surg_hardware import robot_clock
from surg_hardware.conditions import Reading


class AdapterError(Exception):
    """The robot does not answer or does not obey; says why. The driver connects anew."""


@dataclass(frozen=True)
class ArmState:
    """One state of the robot: angles [rad] and velocities [rad/s], one per joint."""

    time: float  # on the robot's own clock [s]; a value that goes back is a restart
    q: tuple[float, ...]
    qd: tuple[float, ...]
    reading: Reading  # `conditions.READY` where it could move
    obeys: bool  # whether it executes velocities now
    ahead: tuple[float, ...] = ()  # targets of its joints minus their angles; empty: unknown
    wrench: tuple[float, ...] = ()  # (6,) as in `driver_datagrams.StateDatagram`


@dataclass(frozen=True)
class ArmIdentity:
    """What the robot says of itself, for the comparison with the cell.

    ``serial`` is None where it cannot be asked; ``flange`` is the upper three rows of the flange's
    pose in the robot's base as ROS has it, row by row (12,), at the joints of the newest state. The
    payload is what the robot reckons with.
    """

    model: str
    flange: tuple[float, ...]
    serial: str | None = None
    mass: float = 0.0  # [kg]
    cog: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m]


class RobotAdapter(ABC):
    """One robot.

    Args:
        address: Of its controller, IPv4.
        options: Section ``settings`` of the link's YAML with dotted keys.

    Raises:
        ValueError: An option is missing, wrong or unknown; the text states what is allowed.
    """

    cycle = 0.002
    """[s] Between two states."""
    clock_window = robot_clock.WINDOW
    """[s] See `robot_clock.RobotClock`."""

    def __init__(self, address: str, options: Mapping[str, object]) -> None:
        self.address = address
        self.options = options

    @abstractmethod
    def connect(self) -> None:
        """Connect; nothing moves by it.

        Raises:
            AdapterError: It does not answer; asked again later.
            arm_driver.RobotRefused: It must not be driven by this adapter.
        """

    @abstractmethod
    def state(self) -> ArmState:
        """Wait for the next state; 0.02 s at most where the library allows it.

        Raises:
            AdapterError: The connection is lost.
            TimeoutError: No state has come; asked again.
        """

    @abstractmethod
    def identity(self) -> ArmIdentity:
        """What the robot says of itself; asked once a second, at rest."""

    @abstractmethod
    def send(self, qd: Sequence[float]) -> None:
        """Give joint velocities [rad/s] for the newest state; the first one begins the motion.

        Raises:
            AdapterError: The robot does not take it.
        """

    @abstractmethod
    def stop(self) -> None:
        """End the motion: the arm comes to rest, without a jump. Returns at once."""

    def guide(self) -> str:
        """Let a person guide the arm by hand; returns why not, or nothing."""
        return "press the guiding button on the arm"

    def recover(self) -> str:
        """Clear a stop that the robot made by itself; returns why not, or nothing."""
        return "this robot is recovered on its own controller"

    @abstractmethod
    def close(self) -> None:
        """Release the robot, which may be lost already."""


def numbers(
    options: Mapping[str, object], key: str, count: int, lowest: float, highest: float
) -> list[float]:
    """A list of numbers among the options of a link.

    Raises:
        ValueError: It is missing, of another length, or out of range.
    """
    value = options.get(key)
    allowed = f"allowed are {count} numbers from {lowest:g} to {highest:g}"
    if not isinstance(value, list | tuple) or len(value) != count:
        raise ValueError(f"settings.{key}: {value!r}; {allowed}")
    if not all(isinstance(each, int | float) and lowest <= each <= highest for each in value):
        raise ValueError(f"settings.{key}: {value!r}; {allowed}")
    return [float(each) for each in value]


def refuse_unknown(options: Mapping[str, object], known: Sequence[str]) -> None:
    """Refuse options that nobody reads.

    Raises:
        ValueError: There is one.
    """
    for key in options:
        if key not in known:
            raise ValueError(f"settings.{key}: is not a known key; allowed: {', '.join(known)}")


def finite_or_zero(values: Sequence[float]) -> tuple[float, ...]:
    """Values of a sensor that may be missing."""
    return tuple(value if math.isfinite(value) else 0.0 for value in values)
