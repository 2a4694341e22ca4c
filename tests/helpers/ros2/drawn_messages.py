"""ROS 1 messages with drawn values, and their CDR by another way: value by value."""

from __future__ import annotations

import random
import re
import struct
from typing import Any

import genpy
import roslib.message

from surg_ros2.message_types_node import packed as packed

FORMATS = {
    "bool": "?", "byte": "b", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
LENGTHS = (0, 0, 1, 2, 3, 5)
"""Of drawn sequences."""


def message_class(kind: str) -> Any:
    """The class of a message type."""
    return roslib.message.get_message_class("std_msgs/Header" if kind == "Header" else kind)


def draw(kind: str, rng: random.Random) -> Any:
    """A value of a type: a primitive one, an array or a message."""
    if array := re.fullmatch(r"([\w/]+)\[(\d*)\]", kind):
        count = int(array[2]) if array[2] else rng.choice(LENGTHS)
        items = [draw(array[1], rng) for _ in range(count)]
        return bytes(items) if array[1] in ("uint8", "char") else items
    if kind == "string":
        return "".join(rng.choice("ab µ") for _ in range(rng.randrange(9)))
    if kind in ("time", "duration"):
        made = genpy.Time if kind == "time" else genpy.Duration
        return made(rng.randrange(2**31), rng.randrange(10**9))
    if kind in FORMATS:
        size = struct.calcsize("<" + FORMATS[kind])
        bits = bytes([rng.randrange(2)]) if kind == "bool" else rng.randbytes(size)
        if kind.startswith("float"):
            bits = struct.pack("<" + FORMATS[kind], rng.gauss(0.0, 1.0))
        return struct.unpack("<" + FORMATS[kind], bits)[0]
    return filled(message_class(kind), rng)


def filled(made: Any, rng: random.Random) -> Any:
    """A message of a class with drawn values."""
    return made(*[draw(each, rng) for each in made._slot_types])


def without_seq(message: Any) -> Any:
    """The message with the ``seq`` of its headers at 0, as it comes back from ROS 2."""
    for slot in message.__slots__:
        value = getattr(message, slot)
        for each in value if isinstance(value, list) else [value]:
            if hasattr(each, "__slots__"):
                without_seq(each)
    if isinstance(message, message_class("Header")):
        message.seq = 0
    return message


def cdr(kind: str, message: Any) -> bytes:
    """A message in CDR, as the OMG's specification says it, value by value."""
    out = bytearray()

    def put(form: str, value: Any) -> None:
        size = struct.calcsize("<" + form)
        out.extend(bytes(-len(out) % size) + struct.pack("<" + form, value))

    def add(kind: str, value: Any) -> None:
        if array := re.fullmatch(r"([\w/]+)\[(\d*)\]", kind):
            if not array[2]:
                put("I", len(value))
            for item in value:
                add(array[1], item)
        elif kind == "string":
            text = value.encode() + b"\0"
            put("I", len(text))
            out.extend(text)
        elif kind in ("time", "duration"):
            put("I", value.secs)
            put("I", value.nsecs)
        elif kind in FORMATS:
            put(FORMATS[kind], value)
        else:
            slots = dict(zip(value.__slots__, value._slot_types, strict=True))
            if kind in ("Header", "std_msgs/Header"):
                del slots["seq"]
            if not slots:
                put("B", 0)
            for name, each in slots.items():
                add(each, getattr(value, name))

    add(kind, message)
    return b"\0\1\0\0" + bytes(out)
