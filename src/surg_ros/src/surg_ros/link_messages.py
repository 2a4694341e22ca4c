"""The 500 Hz messages of a robot link as bytes, packed in one go from prebuilt layouts.

A ROS 1 message is its members in order, little endian, with a length before every string and
array. Building and serialising message objects at this rate would cost more than the physics of a
simulator; a test compares every layout with the generated classes. The simulator and the links to
real arms share them. No ROS.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_core.contract import SECOND_NS

Array = NDArray[np.float64]


def text(words: str) -> bytes:
    """A string with its length in front."""
    data = words.encode()
    return struct.pack("<I", len(data)) + data


def header(seq: int, stamp_ns: int, frame: bytes = b"\0\0\0\0") -> bytes:
    """A std_msgs/Header; ``frame`` is the frame id with its length in front."""
    return struct.pack("<3I", seq & 0xFFFFFFFF, *divmod(stamp_ns, SECOND_NS)) + frame


def doubles(values: Array) -> bytes:
    """A float64[] with its length in front."""
    return struct.pack("<I", len(values)) + np.ascontiguousarray(values, dtype="<f8").tobytes()


class JointStateLayout:
    """sensor_msgs/JointState with fixed names, positions and velocities, no efforts."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = struct.pack("<I", len(names)) + b"".join(map(text, names))

    def pack(self, seq: int, stamp_ns: int, position: Array, velocity: Array) -> bytes:
        """The message as bytes; position and velocity are (n,)."""
        values = doubles(position), doubles(velocity)
        return b"".join((header(seq, stamp_ns), self._names, *values, b"\0\0\0\0"))


@dataclass(frozen=True)
class LinkSays:
    """What a link says of itself beside the tick; members as in surg_msgs/LinkStatus.

    ``serial`` is empty for a simulated arm.
    """

    condition: int
    command: str
    last_command_ns: int
    dead_man: bool
    lockstep: bool
    fault: str
    speed_scaling: float = 1.0
    serial: str = ""

    def pack(self, stamp_ns: int, tick: int) -> bytes:
        """A surg_msgs/LinkStatus as bytes."""
        return b"".join(
            (
                header(tick, stamp_ns),
                struct.pack("<QB", tick, self.condition),
                text(self.command),
                struct.pack("<2I", *divmod(self.last_command_ns, SECOND_NS)),
                struct.pack("<2B", self.dead_man, self.lockstep),
                text(self.fault),
                text(self.serial),
                struct.pack("<dB", self.speed_scaling, 1),
            )
        )


def pack_wrench(seq: int, stamp_ns: int, frame: bytes, wrench: Sequence[float]) -> bytes:
    """A geometry_msgs/WrenchStamped as bytes.

    Args:
        seq: Of the header.
        stamp_ns: When it was measured [ns].
        frame: Id of the frame with its length in front, see `text`.
        wrench: Force [N] and torque [N m] (6,).
    """
    return header(seq, stamp_ns, frame) + struct.pack("<6d", *wrench)


def unpack_header(data: bytes) -> tuple[int, int]:
    """Stamp [ns] and offset behind the header.

    Raises:
        struct.error: The data are too short.
    """
    _, seconds, nanoseconds, length = struct.unpack_from("<4I", data)
    return seconds * SECOND_NS + nanoseconds, 16 + length


def _skip_strings(data: bytes, offset: int) -> int:
    (count,) = struct.unpack_from("<I", data, offset)
    offset += 4
    for _ in range(count):
        (length,) = struct.unpack_from("<I", data, offset)
        offset += 4 + length
    return offset


def _read_doubles(data: bytes, offset: int) -> tuple[Array, int]:
    (count,) = struct.unpack_from("<I", data, offset)
    end = offset + 4 + 8 * count
    if end > len(data):
        raise struct.error(f"array of {count} doubles in {len(data)} bytes")
    return np.frombuffer(data, dtype="<f8", count=count, offset=offset + 4), end


def unpack_joint_state(data: bytes) -> tuple[int, Array, Array]:
    """Stamp [ns], positions and velocities of a sensor_msgs/JointState.

    Raises:
        struct.error: The data are not such a message.
    """
    stamp_ns, offset = unpack_header(data)
    offset = _skip_strings(data, offset)
    position, offset = _read_doubles(data, offset)
    velocity, _ = _read_doubles(data, offset)
    return stamp_ns, position, velocity


def unpack_twist(data: bytes) -> tuple[int, Array]:
    """Stamp [ns] and (6,) linear, angular of a geometry_msgs/TwistStamped.

    Raises:
        struct.error: The data are not such a message.
    """
    stamp_ns, offset = unpack_header(data)
    return stamp_ns, np.array(struct.unpack_from("<6d", data, offset))
