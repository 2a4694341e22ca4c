"""What a person asks of a UR arm that no program drives: where it is, power, brakes, unlocking.

Nothing here needs ROS. The robot takes orders in remote control only; the caller has asked a
person before.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from dataclasses import dataclass

from surg_hardware import identity
from surg_hardware.ur import orders
from surg_hardware.ur.orders import Order, Orders
from surg_hardware.ur.rtde import Rtde, Values

POWER_TIMEOUT = 60.0
"""[s] For the motors to have power, and for the brakes to be released."""
_LOOK = 0.1


class Refused(Exception):
    """The robot does not do it; says why, and what to do."""


@dataclass(frozen=True)
class Standstill:
    """Where an arm is, by its own controller.

    Attributes:
        serial: Of the arm.
        q: Joint positions [rad].
        X_BF: Its own flange pose (4, 4) in ROS's base_link.
    """

    serial: str
    q: tuple[float, ...]
    X_BF: identity.Array


def standstill(address: str, timeout: float = 3.0) -> Standstill:
    """Ask an arm where it is.

    Raises:
        OSError: It does not answer.
    """
    serial, _ = orders.of(address).identity()
    rtde = Rtde(address, inputs=False)
    try:
        values: Values | None = None
        end = time.monotonic() + timeout
        while values is None:
            if time.monotonic() > end:
                raise TimeoutError(f"the robot has sent no state within {timeout:g} s")
            select.select((rtde,), (), (), _LOOK)
            values = rtde.newest()
    finally:
        rtde.close()
    flange = identity.ur_flange(values["actual_TCP_pose"], values["tcp_offset"])
    return Standstill(serial, values["actual_q"], flange)


# --- power and unlocking ------------------------------------------------------------------------


def power_on(address: str, tell: Callable[[str], None], timeout: float = POWER_TIMEOUT) -> None:
    """Power the motors and release the brakes.

    Raises:
        Refused: A stop is in force, or the robot is in local control, or it takes too long.
        OSError: It does not answer.
    """
    robot = orders.of(address)
    safety = robot.safety()
    if safety not in ("NORMAL", "REDUCED"):
        raise Refused(f"safety status {safety}: ./surg robot CELL recover")
    if robot.robot_mode() == "RUNNING":
        tell("the arm is powered and its brakes are released")
        return
    tell("the motors are powered")
    _order(robot, Order.POWER_ON, timeout)
    _await(robot, ("IDLE", "RUNNING"), timeout)
    tell("the brakes are released")
    _order(robot, Order.RELEASE_BRAKES, timeout)
    _await(robot, ("RUNNING",), timeout)


def power_off(address: str, tell: Callable[[str], None], timeout: float = POWER_TIMEOUT) -> None:
    """Cut the motors' power: the brakes hold the arm.

    Raises:
        Refused: As `power_on`.
        OSError: It does not answer.
    """
    robot = orders.of(address)
    _order(robot, Order.POWER_OFF, timeout)
    _await(robot, ("POWER_OFF",), timeout)
    tell("the arm is off, its brakes hold it")


def recover(address: str, tell: Callable[[str], None]) -> None:
    """Unlock a protective stop, or restart the safety system after a violation or a fault.

    Raises:
        Refused: Only a person at the robot can end this state.
        OSError: It does not answer.
    """
    robot = orders.of(address)
    safety = robot.safety()
    if safety in ("NORMAL", "REDUCED"):
        tell("there is nothing to recover from")
    elif safety == "PROTECTIVE_STOP":
        _order(robot, Order.UNLOCK, cure="look for the cause, wait 5 s, then repeat this command")
        tell("the protective stop is unlocked: ./surg robot CELL start")
    elif safety in ("VIOLATION", "FAULT"):
        _order(robot, Order.RESTART_SAFETY)
        tell("the safety system was restarted, the arm is off: ./surg robot CELL on")
    elif "EMERGENCY" in safety:
        raise Refused("emergency stop: release its button; then ./surg robot CELL on")
    else:
        raise Refused(f"safety status {safety}: end it at the robot, see its pendant")


def _order(
    robot: Orders, order: Order, timeout: float = orders.ANSWER, cure: str = "see its pendant"
) -> None:
    """Give an order.

    Raises:
        Refused: The robot is in local control, or does not obey; ``cure`` is for the second.
    """
    if refusal := robot.order(order, timeout):
        raise Refused(refusal if refusal == orders.LOCAL else f"{refusal}: {cure}")


def _await(robot: Orders, modes: tuple[str, ...], timeout: float) -> None:
    end = time.monotonic() + timeout
    while (mode := robot.robot_mode()) not in modes:
        if time.monotonic() > end:
            raise Refused(f"the robot is still {mode} after {timeout:g} s: see its pendant")
        time.sleep(_LOOK)
