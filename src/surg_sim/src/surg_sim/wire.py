"""The bridge's 500 Hz messages as bytes, packed in one go from prebuilt layouts.

A ROS 1 message is its members in order, little endian, with a length before every string and
array. Building and serialising message objects at this rate would cost more than the physics; a
test compares every layout with the generated classes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from surg_sim.truth import ArmTruth

Array = NDArray[np.float64]

NS = 1_000_000_000


def text(words: str) -> bytes:
    """A string with its length in front."""
    data = words.encode()
    return struct.pack("<I", len(data)) + data


def header(seq: int, stamp_ns: int, frame: bytes = b"\0\0\0\0") -> bytes:
    """A std_msgs/Header; ``frame`` is the frame id with its length in front."""
    return struct.pack("<3I", seq & 0xFFFFFFFF, *divmod(stamp_ns, NS)) + frame


def _doubles(values: Array) -> bytes:
    return struct.pack("<I", len(values)) + np.ascontiguousarray(values, dtype="<f8").tobytes()


class JointStateLayout:
    """sensor_msgs/JointState with fixed names, positions and velocities, no efforts.

    Args:
        names: Joint names.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = struct.pack("<I", len(names)) + b"".join(map(text, names))

    def pack(self, seq: int, stamp_ns: int, position: Array, velocity: Array) -> bytes:
        """The message as bytes; position and velocity are (n,)."""
        return b"".join(
            (
                header(seq, stamp_ns),
                self._names,
                _doubles(position),
                _doubles(velocity),
                b"\0\0\0\0",
            )
        )


def pack_link_status(
    stamp_ns: int,
    tick: int,
    command: str,
    last_command_ns: int,
    dead_man: bool,
    lockstep: bool,
    fault: str,
) -> bytes:
    """A surg_msgs/LinkStatus as bytes."""
    return b"".join(
        (
            header(tick, stamp_ns),
            struct.pack("<Q", tick),
            text(command),
            struct.pack("<2I2B", *divmod(last_command_ns, NS), dead_man, lockstep),
            text(fault),
        )
    )


def pack_point_velocity(
    stamp_ns: int, seq: int, frame: bytes, point: Array, velocity: Array
) -> bytes:
    """A surg_msgs/PointVelocityStamped as bytes; ``frame`` as for ``header``."""
    return header(seq, stamp_ns, frame) + struct.pack("<6d", *point, *velocity)


def pack_ground_truth(stamp_ns: int, tick: int, arms: Iterable[tuple[str, ArmTruth]]) -> bytes:
    """A surg_msgs/GroundTruth as bytes."""
    parts = []
    for name, truth in arms:
        parts += [
            text(name),
            struct.pack(
                "<22d",
                *truth.shaft_point,
                *truth.shaft_axis,
                *truth.tip,
                *truth.tip_velocity,
                *truth.trocar,
                *truth.trocar_loaded,
                *truth.trocar_force,
                truth.jaw,
            ),
        ]
    count = struct.pack("<QI", tick, len(parts) // 2)
    return b"".join((header(tick, stamp_ns), count, *parts))


def unpack_header(data: bytes) -> tuple[int, int]:
    """Stamp [ns] and offset behind the header.

    Raises:
        struct.error: The data are too short.
    """
    _, seconds, nanoseconds, length = struct.unpack_from("<4I", data)
    return seconds * NS + nanoseconds, 16 + length


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
