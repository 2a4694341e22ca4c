"""Messages of a UR controller to its primary clients, as bytes behind their common head."""

from __future__ import annotations

import struct
from dataclasses import dataclass

TEXT, VERSION, SAFETY_MODE, ERROR_CODE, KEY, RUNTIME_EXCEPTION = 0, 3, 5, 6, 7, 10
READ_ONLY = 210
"""Error code of a script that came while the robot is in local control."""
PROTECTIVE_STOP = 209
"""Error code of a protective stop that a program asks for; here of every one."""
WARNING, VIOLATION = 2, 3
"""Report levels."""


@dataclass(frozen=True)
class RobotMessage:
    """One message: its kind and what follows its head."""

    kind: int
    body: bytes


def text(said: str) -> RobotMessage:
    """A line of the log."""
    return RobotMessage(TEXT, said.encode())


def key(title: str, name: str) -> RobotMessage:
    """An event with a title, such as the start of a program."""
    body = struct.pack(">iiB", 0, 0, len(title)) + title.encode() + name.encode()
    return RobotMessage(KEY, body)


def runtime_exception(line: int, column: int, said: str) -> RobotMessage:
    """A program has failed at a place; both count from 1, and 0 is unknown."""
    return RobotMessage(RUNTIME_EXCEPTION, struct.pack(">ii", line, column) + said.encode())


def error_code(code: int, said: str, level: int = VIOLATION) -> RobotMessage:
    """An error by its number and report level."""
    return RobotMessage(ERROR_CODE, struct.pack(">iiiII", code, 0, level, 0, 0) + said.encode())


def safety_mode(mode: int) -> RobotMessage:
    """The safety mode is another one now."""
    return RobotMessage(SAFETY_MODE, struct.pack(">iiBII", 0, 0, mode, 0, 0))
