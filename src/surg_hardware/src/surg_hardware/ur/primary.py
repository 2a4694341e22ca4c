"""The primary interface of a UR controller: programs go up, the arm's own kinematics come down.

Both may take seconds: nothing here is called from the loop of a driver.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass

from surg_hardware.driver_process import finite
from surg_hardware.ur.orders import ANSWER

PRIMARY_PORT = 30001
_LOOK = 0.02  # [s] between two looks whether a program has started
_HEAD = struct.Struct(">IB")
_ROBOT_STATE, _KINEMATICS = 16, 5
_KINEMATICS_LAYOUT = struct.Struct(">6I24dI")
_LONGEST = 1 << 16


@dataclass(frozen=True)
class Kinematics:
    """An arm's own standard Denavit-Hartenberg parameters, one value per joint [rad, m]."""

    theta: tuple[float, ...]
    a: tuple[float, ...]
    d: tuple[float, ...]
    alpha: tuple[float, ...]


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


def upload(
    address: str,
    program: str,
    started: Callable[[], bool],
    wanted: Callable[[], bool],
    timeout: float = ANSWER,
) -> None:
    """Send a program, and keep the connection until the controller says that it has started.

    Args:
        address: Of the robot, in remote control.
        program: Text in URScript.
        started: Whether the controller says that the program runs.
        wanted: Whether it is still wanted; where not, it is not sent, or no longer waited for.
        timeout: Longest wait [s].

    Raises:
        OSError: The port does not take it, or it has not started within the time.
    """
    with socket.create_connection((address, PRIMARY_PORT), timeout) as peer:
        if wanted():
            peer.sendall(program.encode("ascii"))
        deadline = time.monotonic() + timeout
        while wanted() and not started():
            if time.monotonic() > deadline:
                raise TimeoutError(f"the program has not started within {timeout:g} s")
            time.sleep(_LOOK)
