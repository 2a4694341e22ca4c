"""What is asked and ordered of a UR controller beside its motion, in the words of no version.

PolyScope 5 answers on its `dashboard`, PolyScope X by its `robot_api`; `of` takes the one that the
controller's version has. All of it may take seconds: nothing here is called from a driver's loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Protocol

from surg_hardware.ur.controller_version import controller_version
from surg_hardware.ur.rtde import RtdeRefused

OLDEST, OLDEST_X = (5, 6), (10, 14)
"""Versions of PolyScope and of PolyScope X that tell serial number and remote control."""
POLYSCOPE_X = 10
"""Major version from which on a controller has a robot API and no dashboard server."""
ANSWER = 10.0
"""[s] Longest wait for an answer, and for a program to start: the maker's library waits so long."""
LOCAL = "the robot is in local control: switch it to remote control on the pendant"


class Order(Enum):
    """What a controller is told, in the words of PolyScope 5."""

    POWER_ON = "power on"
    POWER_OFF = "power off"
    RELEASE_BRAKES = "brake release"
    UNLOCK = "unlock protective stop"
    RESTART_SAFETY = "restart safety"
    STOP = "stop"


class Orders(Protocol):
    """One controller. Every method raises OSError where it does not answer."""

    def version(self) -> str:
        """Of its software, with at least major and minor."""

    def identity(self) -> tuple[str, str]:
        """Serial number and model."""

    def remote(self) -> bool:
        """Whether it is in remote control."""

    def running(self) -> bool:
        """Whether a program runs."""

    def robot_mode(self) -> str:
        """Such as POWER_OFF, IDLE or RUNNING."""

    def safety(self) -> str:
        """Such as NORMAL or PROTECTIVE_STOP."""

    def order(self, order: Order, timeout: float = ANSWER) -> str:
        """Give an order; returns why the robot does not obey, or nothing. ``timeout``: [s]."""


def refuse_version(version: Sequence[int]) -> None:
    """Refuse a controller by its version (major, minor, …); empty: it tells none.

    Raises:
        RtdeRefused: It cannot be driven.
    """
    oldest, name = OLDEST, "PolyScope"
    if version and version[0] >= POLYSCOPE_X:
        oldest, name = OLDEST_X, "PolyScope X"
    if version and tuple(version[:2]) < oldest:
        raise RtdeRefused(
            f"the controller's version is {'.'.join(map(str, version))}",
            f"{name} {'.'.join(map(str, oldest))} or newer is needed: update the robot",
        )


def of(address: str) -> Orders:
    """The way to a controller that its version has.

    Raises:
        RtdeRefused: This version cannot be driven.
    """
    from surg_hardware.ur.dashboard import Dashboard
    from surg_hardware.ur.robot_api import RobotApi

    version = controller_version(address)
    refuse_version(version)
    if version and version[0] >= POLYSCOPE_X:
        return RobotApi(address)
    return Dashboard(address)
