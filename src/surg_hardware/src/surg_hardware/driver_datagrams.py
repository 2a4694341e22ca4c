"""Datagrams between the driver of an arm and its node: fixed structs, sizes checked.

The two processes are on one machine and share a socket pair; every datagram begins with its kind.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from surg_hardware.conditions import Condition
from surg_hardware.robot_adapter import ArmIdentity
from surg_hardware.robot_link import Status

MOST_JOINTS = 8
MOST_TEXT = 400
"""[bytes] Of a sentence."""
LONGEST = 1024
"""[bytes] Of a datagram."""
REQUESTS = ("start", "stop", "guide", "recover")

_STATE, _IDENTITY, _NOTICE, _COMMAND, _REQUEST = range(1, 6)
_STATE_LAYOUT = struct.Struct("<BBBBBqQqd8d8d6d")
_IDENTITY_LAYOUT = struct.Struct("<B8dB12dd3dB32s32s")
_COMMAND_LAYOUT = struct.Struct("<BBq8d")
_REQUEST_LAYOUT = struct.Struct("<BB8s")


_NO_WRENCH = (0.0,) * 6


class DatagramError(ValueError):
    """A datagram that is none of these."""


@dataclass(frozen=True)
class StateDatagram:
    """The arm's state, and what its link says; without joints where no state has come."""

    stamp_ns: int  # when the robot took the state, wall clock
    tick: int
    q: tuple[float, ...]
    qd: tuple[float, ...]
    status: Status
    # (6,) force [N] and torque [N m] from outside, in the robot's base as ROS has it, by the
    # robot's own estimate; empty: it makes none
    wrench: tuple[float, ...] = ()

    def pack(self) -> bytes:
        """As bytes."""
        status = self.status
        head = _STATE_LAYOUT.pack(
            _STATE,
            len(self.q),
            status.condition,
            status.dead_man,
            len(self.wrench),
            self.stamp_ns,
            self.tick,
            status.last_command_ns,
            status.speed_scaling,
            *_padded(self.q),
            *_padded(self.qd),
            *(self.wrench or _NO_WRENCH),
        )
        return head + _cut(status.fault)


@dataclass(frozen=True)
class IdentityDatagram:
    """What the robot says of itself, at rest, and its angles then [rad]."""

    q: tuple[float, ...]
    said: ArmIdentity

    def pack(self) -> bytes:
        """As bytes."""
        said = self.said
        return _IDENTITY_LAYOUT.pack(
            _IDENTITY,
            *_padded(self.q),
            len(self.q),
            *said.flange,
            said.mass,
            *said.cog,
            said.serial is not None,
            (said.serial or "").encode()[:32],
            said.model.encode()[:32],
        )


@dataclass(frozen=True)
class NoticeDatagram:
    """A sentence of the driver, such as the answer to a request."""

    text: str

    def pack(self) -> bytes:
        """As bytes."""
        return bytes((_NOTICE,)) + _cut(self.text)


@dataclass(frozen=True)
class CommandDatagram:
    """Joint velocities of the controller [rad/s]; with a wrong number of them it has none."""

    stamp_ns: int
    qd: tuple[float, ...]

    def pack(self) -> bytes:
        """As bytes."""
        qd = self.qd if len(self.qd) <= MOST_JOINTS else ()
        return _COMMAND_LAYOUT.pack(_COMMAND, len(qd), self.stamp_ns, *_padded(qd))


@dataclass(frozen=True)
class RequestDatagram:
    """One word of `REQUESTS`, and whether the controller is ENABLED."""

    word: str
    enabled: bool

    def pack(self) -> bytes:
        """As bytes."""
        return _REQUEST_LAYOUT.pack(_REQUEST, self.enabled, self.word.encode()[:8])


FromDriver = StateDatagram | IdentityDatagram | NoticeDatagram
FromNode = CommandDatagram | RequestDatagram


def decode_from_driver(data: bytes) -> FromDriver:
    """Read what the driver has sent.

    Raises:
        DatagramError: It is none of its datagrams.
    """
    kind = data[0] if data else 0
    if kind == _STATE and _STATE_LAYOUT.size <= len(data) <= _STATE_LAYOUT.size + MOST_TEXT:
        _, n, condition, dead_man, forces, stamp_ns, tick, last_ns, scaling, *joints = (
            _STATE_LAYOUT.unpack_from(data)
        )
        known = condition in Condition.__members__.values()
        if n > MOST_JOINTS or not known or forces not in (0, 6):
            raise DatagramError(f"{n} joints, condition {condition}, {forces} forces")
        fault = data[_STATE_LAYOUT.size :].decode("utf-8", "replace")
        status = Status(Condition(condition), fault, bool(dead_man), last_ns, scaling)
        q, qd = joints[:n], joints[MOST_JOINTS : MOST_JOINTS + n]
        wrench = joints[2 * MOST_JOINTS :][:forces]
        return StateDatagram(stamp_ns, tick, tuple(q), tuple(qd), status, tuple(wrench))
    if kind == _IDENTITY and len(data) == _IDENTITY_LAYOUT.size:
        values = _IDENTITY_LAYOUT.unpack(data)
        n = values[9]
        if n > MOST_JOINTS:
            raise DatagramError(f"{n} joints")
        said = ArmIdentity(
            model=_text(values[28]),
            flange=values[10:22],
            serial=_text(values[27]) if values[26] else None,
            mass=values[22],
            cog=(values[23], values[24], values[25]),
        )
        return IdentityDatagram(values[1 : 1 + n], said)
    if kind == _NOTICE and len(data) <= 1 + MOST_TEXT:
        return NoticeDatagram(data[1:].decode("utf-8", "replace"))
    raise DatagramError(f"kind {kind} with {len(data)} bytes")


def decode_to_driver(data: bytes) -> FromNode:
    """Read what the node has sent.

    Raises:
        DatagramError: It is none of its datagrams.
    """
    kind = data[0] if data else 0
    if kind == _COMMAND and len(data) == _COMMAND_LAYOUT.size:
        _, n, stamp_ns, *qd = _COMMAND_LAYOUT.unpack(data)
        if n > MOST_JOINTS:
            raise DatagramError(f"{n} joints")
        return CommandDatagram(stamp_ns, tuple(qd[:n]))
    if kind == _REQUEST and len(data) == _REQUEST_LAYOUT.size:
        _, enabled, word = _REQUEST_LAYOUT.unpack(data)
        return RequestDatagram(_text(word), bool(enabled))
    raise DatagramError(f"kind {kind} with {len(data)} bytes")


def _padded(values: Sequence[float]) -> tuple[float, ...]:
    return (*values, *(0.0,) * (MOST_JOINTS - len(values)))


def _cut(text: str) -> bytes:
    return text.encode()[:MOST_TEXT]


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode("utf-8", "replace")
