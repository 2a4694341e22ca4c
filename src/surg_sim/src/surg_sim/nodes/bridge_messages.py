"""The bridge's 500 Hz messages as bytes, packed in one go from prebuilt layouts.

A ROS 1 message is its members in order, little endian, with a length before every string and
array. Building and serialising message objects at this rate would cost more than the physics; a
test compares every layout with the generated classes.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from surg_core.contract import SECOND_NS
from surg_sim.arrays import Array
from surg_sim.physics.ground_truth import ArmTruth
from surg_sim.tasks import Verdict


def text(words: str) -> bytes:
    """A string with its length in front."""
    data = words.encode()
    return struct.pack("<I", len(data)) + data


def header(seq: int, stamp_ns: int, frame: bytes = b"\0\0\0\0") -> bytes:
    """A std_msgs/Header; ``frame`` is the frame id with its length in front."""
    return struct.pack("<3I", seq & 0xFFFFFFFF, *divmod(stamp_ns, SECOND_NS)) + frame


def _doubles(values: Array) -> bytes:
    return struct.pack("<I", len(values)) + np.ascontiguousarray(values, dtype="<f8").tobytes()


class JointStateLayout:
    """sensor_msgs/JointState with fixed names, positions and velocities, no efforts."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = struct.pack("<I", len(names)) + b"".join(map(text, names))

    def pack(self, seq: int, stamp_ns: int, position: Array, velocity: Array) -> bytes:
        """The message as bytes; position and velocity are (n,)."""
        values = _doubles(position), _doubles(velocity)
        return b"".join((header(seq, stamp_ns), self._names, *values, b"\0\0\0\0"))


@dataclass(frozen=True)
class LinkSays:
    """What a link says of itself beside the tick; members as in surg_msgs/LinkStatus."""

    condition: int
    command: str
    last_command_ns: int
    dead_man: bool
    lockstep: bool
    fault: str
    speed_scaling: float = 1.0

    def pack(self, stamp_ns: int, tick: int) -> bytes:
        """A surg_msgs/LinkStatus as bytes; a simulated arm has no serial number."""
        return b"".join(
            (
                header(tick, stamp_ns),
                struct.pack("<QB", tick, self.condition),
                text(self.command),
                struct.pack("<2I", *divmod(self.last_command_ns, SECOND_NS)),
                struct.pack("<2B", self.dead_man, self.lockstep),
                text(self.fault),
                text(""),
                struct.pack("<dB", self.speed_scaling, 1),
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
        *vectors, jaw = truth
        parts.append(text(name) + np.concatenate(vectors).tobytes() + struct.pack("<d", jaw))
    count = struct.pack("<QI", tick, len(parts))
    return b"".join((header(tick, stamp_ns), count, *parts))


class TaskStateLayout:
    """surg_msgs/TaskState of a task, whose entries keep their names, order and shapes.

    They are those of an example of what the task says of itself.
    """

    def __init__(self, state: Mapping[str, float | Array]) -> None:
        self._shapes = {name: np.shape(value) for name, value in state.items()}
        self.names = [_entry(name, shape) for name, shape in self._shapes.items()]
        self._head = struct.pack("<I", len(self.names)) + b"".join(map(text, self.names))

    def pack(
        self, stamp_ns: int, tick: int, state: Mapping[str, float | Array], verdict: Verdict
    ) -> bytes:
        """The message as bytes.

        Raises:
            ValueError: An entry has come, gone or changed its shape.
        """
        shapes = {name: np.shape(value) for name, value in state.items()}
        if shapes != self._shapes:
            raise ValueError(f"the task's state was {self._shapes} and is {shapes}")
        flat = [np.ravel(value) for value in state.values()]
        values = np.concatenate(flat) if flat else np.zeros(0)
        return b"".join(
            (
                header(tick, stamp_ns),
                struct.pack("<Q", tick),
                self._head,
                _doubles(values),
                text(verdict.phase),
                struct.pack("<2B", verdict.done, verdict.success),
                text(verdict.reason),
                struct.pack("<d", verdict.reward),
            )
        )


def _entry(name: str, shape: tuple[int, ...]) -> str:
    return f"{name}[{','.join(map(str, shape))}]" if shape else name


def task_state(names: Iterable[str], values: Sequence[float]) -> dict[str, float | Array]:
    """The dictionary that ``TaskStateLayout`` has packed.

    Raises:
        ValueError: Names and number of values do not belong together.
    """
    state: dict[str, float | Array] = {}
    start = 0
    for entry in names:
        name, _, rest = entry.partition("[")
        shape = tuple(int(n) for n in rest.rstrip("]").split(",") if n)
        end = start + math.prod(shape)
        part = np.array(values[start:end], dtype=np.float64)
        if len(part) != end - start:
            raise ValueError(f"{len(values)} values end within {entry!r}")
        state[name] = part.reshape(shape) if rest else float(part[0])
        start = end
    if start != len(values):
        raise ValueError(f"{len(values)} values for names of {start}")
    return state


def pack_wrench(stamp_ns: int, seq: int, frame: bytes, force: Array) -> bytes:
    """A geometry_msgs/WrenchStamped without torque; ``frame`` as for ``header``."""
    return header(seq, stamp_ns, frame) + struct.pack("<6d", *force, 0.0, 0.0, 0.0)


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
