"""Bytes of a ROS 1 message to bytes of the same message in ROS 2 (CDR), and back.

Both are little endian and hold the same values in the same order. They differ in four places:

- CDR aligns a value to its size, counted from behind a header of four bytes;
- a text ends with a zero there, which its length counts;
- a `std_msgs/Header` has no ``seq`` there (back in ROS 1 it is 0);
- a message without fields is one byte there.

So nothing is interpreted: a `Codec` copies the bytes between the lengths, with other gaps. It is
made once for each type, from the types of the fields.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

Fields = Callable[[str], Sequence[tuple[str, str]]]
"""Message type -> name and type of its fields, in order."""

SIZES = {
    **dict.fromkeys(("bool", "byte", "char", "int8", "uint8"), (1, 1)),
    **dict.fromkeys(("int16", "uint16"), (2, 2)),
    **dict.fromkeys(("int32", "uint32", "float32"), (4, 4)),
    **dict.fromkeys(("int64", "uint64", "float64"), (8, 8)),
    **dict.fromkeys(("time", "duration"), (8, 4)),
}
"""Primitive type -> bytes, alignment. A time is seconds and nanoseconds, of four bytes each."""
HEADER = b"\0\1\0\0"
"""Of a plain CDR message in little endian; no ROS 2 on x86 or ARM sends another."""
MAX_PADDING = 3
"""Bytes behind a message that only fill it up to a multiple of four."""
_LENGTH = struct.Struct("<I")
_FORM = re.compile(r"(?P<item>[\w/]+)(?:\[(?P<count>\d*)\])?")


class Malformed(ValueError):
    """Bytes that are no message of the type; says where they end to fit."""


class _Step(Protocol):
    """One part of a message; reads ``data`` from ``at``, appends to ``out``, returns where next."""

    def to_ros2(self, data: bytes, at: int, out: bytearray) -> int: ...

    def to_ros1(self, data: bytes, at: int, out: bytearray) -> int: ...


@dataclass
class _Block:
    """Neighbouring values of fixed size: one copy, with gaps that depend on where it begins."""

    # bytes in ROS 1, bytes in CDR, alignment there; unequal sizes: not a value but filling
    pieces: list[tuple[int, int, int]] = field(default_factory=list)
    _forms: list[tuple[struct.Struct, struct.Struct]] = field(default_factory=list)

    def finish(self) -> None:
        """Make the forms for each place that the block can begin at, modulo the alignment."""
        self._forms = [self._form(begin) for begin in range(8)]

    def _form(self, begin: int) -> tuple[struct.Struct, struct.Struct]:
        ros1, ros2, run, at = "<", "<", 0, begin
        for one, two, align in [*self.pieces, (0, 0, 1)]:
            gap = -at % align
            at += gap + two
            if run and (gap or one != two or not one):
                ros1, ros2, run = f"{ros1}{run}s", f"{ros2}{run}s", 0
            ros2 += "x" * gap
            if one == two:
                run += one
            else:
                ros1, ros2 = ros1 + "x" * one, ros2 + "x" * two
        return struct.Struct(ros1), struct.Struct(ros2)

    def to_ros2(self, data: bytes, at: int, out: bytearray) -> int:
        ros1, ros2 = self._forms[(len(out) + len(HEADER)) % 8]
        out += ros2.pack(*ros1.unpack_from(data, at))
        return at + ros1.size

    def to_ros1(self, data: bytes, at: int, out: bytearray) -> int:
        ros1, ros2 = self._forms[(at + len(HEADER)) % 8]
        out += ros1.pack(*ros2.unpack_from(data, at))
        return at + ros2.size


class _Text:
    """A string."""

    def to_ros2(self, data: bytes, at: int, out: bytearray) -> int:
        begin, end = _counted(data, at, 1)
        _pad(out, 4)
        out += _LENGTH.pack(end - begin + 1)
        out += data[begin:end]
        out += b"\0"
        return end

    def to_ros1(self, data: bytes, at: int, out: bytearray) -> int:
        begin, end = _counted(data, _aligned(at, 4), 1)
        text = data[begin : end - 1] if end > begin else b""  # some senders omit the zero of ""
        if end > begin and data[end - 1]:
            raise Malformed(f"the text at byte {begin} does not end with a zero")
        out += _LENGTH.pack(len(text))
        out += text
        return end


@dataclass
class _Values:
    """A sequence of primitive values: one copy."""

    size: int
    align: int

    def to_ros2(self, data: bytes, at: int, out: bytearray) -> int:
        begin, end = _counted(data, at, self.size)
        _pad(out, 4)
        out += data[at:begin]
        if end > begin:
            _pad(out, self.align)
        out += data[begin:end]
        return end

    def to_ros1(self, data: bytes, at: int, out: bytearray) -> int:
        at = _aligned(at, 4)
        (count,) = _LENGTH.unpack_from(data, at)
        begin = _aligned(at + 4, self.align) if count else at + 4
        end = begin + count * self.size
        if end > len(data):
            raise Malformed(f"{count} values are announced at byte {at}")
        out += data[at : at + 4]
        out += data[begin:end]
        return end


@dataclass
class _Items:
    """A sequence of texts or messages."""

    steps: Sequence[_Step]

    def to_ros2(self, data: bytes, at: int, out: bytearray) -> int:
        begin, end = _counted(data, at, 1)
        _pad(out, 4)
        out += data[at:begin]
        at = begin
        for _ in range(end - begin):
            for step in self.steps:
                at = step.to_ros2(data, at, out)
        return at

    def to_ros1(self, data: bytes, at: int, out: bytearray) -> int:
        at = _aligned(at, 4)
        begin, end = _counted(data, at, 1)
        out += data[at:begin]
        at = begin
        for _ in range(end - begin):
            for step in self.steps:
                at = step.to_ros1(data, at, out)
        return at


class Codec:
    """Converts the messages of one type.

    Args:
        kind: The type in ROS 1, such as ``geometry_msgs/PoseStamped``.
        fields: The types of the fields of each message type.

    Raises:
        ValueError: A field has a type that is neither primitive nor a message.
    """

    def __init__(self, kind: str, fields: Fields) -> None:
        self.kind = kind
        self._steps = _steps([("", kind)], fields)

    def to_ros2(self, data: bytes) -> bytes:
        """The message in CDR, with its header.

        Raises:
            Malformed: The bytes are no message of this type.
        """
        out = bytearray(HEADER)
        self._check(self._run([step.to_ros2 for step in self._steps], data, 0, out), data, 0)
        return bytes(out)

    def to_ros1(self, data: bytes) -> bytes:
        """The message as ROS 1 has it on the wire.

        Raises:
            Malformed: The bytes are no message of this type in plain CDR and little endian.
        """
        if data[:2] != HEADER[:2]:
            raise Malformed(f"{self.kind}: header {data[:4].hex()} is not plain little endian CDR")
        out = bytearray()
        end = self._run([step.to_ros1 for step in self._steps], data, len(HEADER), out)
        self._check(end, data, MAX_PADDING)
        return bytes(out)

    def _run(
        self,
        steps: Sequence[Callable[[bytes, int, bytearray], int]],
        data: bytes,
        at: int,
        out: bytearray,
    ) -> int:
        try:
            for step in steps:
                at = step(data, at, out)
        except (Malformed, struct.error) as error:
            raise Malformed(f"{self.kind}: {len(data)} bytes do not fit: {error}") from error
        return at

    def _check(self, end: int, data: bytes, spare: int) -> None:
        if not 0 <= len(data) - end <= spare:
            raise Malformed(f"{self.kind}: {len(data)} bytes, and the message ends at {end}")


def _steps(members: Sequence[tuple[str, str]], fields: Fields) -> list[_Step]:
    """The steps of some fields; neighbours of fixed size become one block."""
    steps: list[_Step] = []
    block = _Block()

    def close() -> None:
        nonlocal block
        if block.pieces:
            block.finish()
            steps.append(block)
        block = _Block()

    def add(kind: str) -> None:
        form = _FORM.fullmatch(kind)
        item, count = (form["item"], form["count"]) if form else (kind, None)
        if count == "":
            close()
            steps.append(_sequence(item, fields))
        elif item in SIZES:
            size, align = SIZES[item]
            size *= int(count or 1)
            block.pieces.append((size, size, align))
        else:
            for _ in range(int(count or 1)):
                add_item(item)

    def add_item(item: str) -> None:
        if item == "string":
            close()
            steps.append(_Text())
            return
        inner = list(fields(item))
        if item in ("Header", "std_msgs/Header"):
            block.pieces.append((4, 0, 1))  # seq
            inner = inner[1:]
        elif not inner:
            block.pieces.append((0, 1, 1))
        for _, kind in inner:
            add(kind)

    for _, kind in members:
        add(kind)
    close()
    return steps


def _sequence(item: str, fields: Fields) -> _Step:
    if item in SIZES:
        return _Values(*SIZES[item])
    return _Items(_steps([("", item)], fields))


def _counted(data: bytes, at: int, size: int) -> tuple[int, int]:
    """Where what a length announces begins, and where it ends at least."""
    (count,) = _LENGTH.unpack_from(data, at)
    begin = at + _LENGTH.size
    if begin + count * size > len(data):
        raise Malformed(f"{count} items are announced at byte {at}")
    return begin, begin + count * size


def _aligned(at: int, align: int) -> int:
    """The next multiple of an alignment, counted from behind the header."""
    return at + (len(HEADER) - at) % align


def _pad(out: bytearray, align: int) -> None:
    out += bytes(_aligned(len(out), align) - len(out))
