"""What a person asks of a UR arm that no program drives: power, brakes, unlocking, kinematics.

Nothing here needs ROS. Every order goes to the dashboard server, which takes it in remote control
only; the caller has asked a person before.
"""

from __future__ import annotations

import select
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass

from surg_hardware import identity
from surg_hardware.driver_process import finite
from surg_hardware.ur import dashboard
from surg_hardware.ur.rtde import Rtde, Values

PRIMARY_PORT = 30001
POWER_TIMEOUT = 60.0
"""[s] For the motors to have power, and for the brakes to be released."""
_LOOK = 0.1
_HEAD = struct.Struct(">IB")
_ROBOT_STATE, _KINEMATICS = 16, 5
_KINEMATICS_LAYOUT = struct.Struct(">6I24dI")
_LONGEST = 1 << 16


class Refused(Exception):
    """The robot does not do it; says why, and what to do."""


@dataclass(frozen=True)
class Kinematics:
    """An arm's own standard Denavit-Hartenberg parameters, one value per joint [rad, m]."""

    theta: tuple[float, ...]
    a: tuple[float, ...]
    d: tuple[float, ...]
    alpha: tuple[float, ...]


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


# --- kinematics -------------------------------------------------------------------------------


def kinematics_in(message: bytes) -> Kinematics | None:
    """The kinematics in a message of the primary interface; None: it has none.

    Args:
        message: Behind its length and its type 16: sub-packages with length and type each.
    """
    at = 0
    while at + _HEAD.size <= len(message):
        length, kind = _HEAD.unpack_from(message, at)
        if length < _HEAD.size:
            return None
        body = message[at + _HEAD.size : at + length]
        if kind == _KINEMATICS and len(body) == _KINEMATICS_LAYOUT.size:
            values = _KINEMATICS_LAYOUT.unpack(body)[6:30]
            theta, a, d, alpha = (values[i : i + 6] for i in range(0, 24, 6))
            return Kinematics(theta, a, d, alpha) if finite(values) else None
        at += length
    return None


def read_kinematics(address: str, timeout: float = 3.0) -> Kinematics:
    """Ask an arm for its own kinematics; moves nothing.

    Raises:
        OSError: It does not answer, or sends none within the time [s].
    """
    end = time.monotonic() + timeout
    rest = b""
    with socket.create_connection((address, PRIMARY_PORT), timeout) as peer:
        while time.monotonic() < end:
            data = peer.recv(_LONGEST)
            if not data:
                raise ConnectionError("the primary interface has closed the connection")
            rest += data
            while len(rest) >= _HEAD.size:
                length, kind = _HEAD.unpack_from(rest)
                if not _HEAD.size <= length <= _LONGEST:
                    raise ConnectionError(f"port {PRIMARY_PORT} is no primary interface")
                if len(rest) < length:
                    break
                found = kinematics_in(rest[_HEAD.size : length]) if kind == _ROBOT_STATE else None
                if found is not None:
                    return found
                rest = rest[length:]
    raise TimeoutError(f"the robot has sent no kinematics within {timeout:g} s")


def standstill(address: str, timeout: float = 3.0) -> Standstill:
    """Ask an arm where it is.

    Raises:
        OSError: It does not answer.
    """
    (serial,) = dashboard.ask(address, ("get serial number",))
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
    safety = _said(address, "safetystatus")
    if safety not in ("NORMAL", "REDUCED"):
        raise Refused(f"safety status {safety}: ./surg robot CELL recover")
    if _said(address, "robotmode") == "RUNNING":
        tell("the arm is powered and its brakes are released")
        return
    tell("the motors are powered")
    _order(address, "power on")
    _await(address, ("IDLE", "RUNNING"), timeout)
    tell("the brakes are released")
    _order(address, "brake release")
    _await(address, ("RUNNING",), timeout)


def power_off(address: str, tell: Callable[[str], None], timeout: float = POWER_TIMEOUT) -> None:
    """Cut the motors' power: the brakes hold the arm.

    Raises:
        Refused: As `power_on`.
        OSError: It does not answer.
    """
    _order(address, "power off")
    _await(address, ("POWER_OFF",), timeout)
    tell("the arm is off, its brakes hold it")


def recover(address: str, tell: Callable[[str], None]) -> None:
    """Unlock a protective stop, or restart the safety system after a violation or a fault.

    Raises:
        Refused: Only a person at the robot can end this state.
        OSError: It does not answer.
    """
    safety = _said(address, "safetystatus")
    if safety in ("NORMAL", "REDUCED"):
        tell("there is nothing to recover from")
    elif safety == "PROTECTIVE_STOP":
        answer = _order(address, "unlock protective stop")
        if answer.lower().startswith("cannot"):
            raise Refused(f"{answer}: look for the cause, wait 5 s, then repeat this command")
        _order(address, "close safety popup")
        tell("the protective stop is unlocked: ./surg robot CELL start")
    elif safety in ("VIOLATION", "FAULT"):
        _order(address, "restart safety")
        tell("the safety system was restarted, the arm is off: ./surg robot CELL on")
    elif "EMERGENCY" in safety:
        raise Refused("emergency stop: release its button; then ./surg robot CELL on")
    else:
        raise Refused(f"safety status {safety}: end it at the robot, see its pendant")


def _said(address: str, question: str) -> str:
    """The answer behind its colon, such as RUNNING of `Robotmode: RUNNING`."""
    (answer,) = dashboard.ask(address, (question,))
    return answer.rpartition(":")[2].strip()


def _order(address: str, order: str) -> str:
    """Give an order.

    Raises:
        Refused: The robot is in local control.
    """
    remote, answer = dashboard.ask(address, ("is in remote control", order), 5.0)
    if remote.lower() != "true":
        raise Refused("the robot is in local control: do it on the pendant, or switch to remote")
    return answer


def _await(address: str, modes: tuple[str, ...], timeout: float) -> None:
    end = time.monotonic() + timeout
    while (mode := _said(address, "robotmode")) not in modes:
        if time.monotonic() > end:
            raise Refused(f"the robot is still {mode} after {timeout:g} s: see its pendant")
        time.sleep(_LOOK)
