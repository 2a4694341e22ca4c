"""A connection to a UR arm: RTDE, the way to give orders, and which arm it is."""

from __future__ import annotations

from dataclasses import dataclass

from surg_hardware.ur import orders
from surg_hardware.ur.orders import Orders
from surg_hardware.ur.rtde import Rtde


@dataclass(frozen=True)
class Connected:
    """What one connection has found; ``rtde`` is open, and its reader closes it."""

    rtde: Rtde
    orders: Orders
    serial: str
    model: str


def connect(address: str) -> Connected:
    """Connect; may take seconds.

    Raises:
        OSError: The robot does not answer.
        RtdeRefused: It cannot be driven: its version, a missing field, another client.
    """
    robot = orders.of(address)
    serial, model = robot.identity()
    return Connected(Rtde(address), robot, serial, model)
