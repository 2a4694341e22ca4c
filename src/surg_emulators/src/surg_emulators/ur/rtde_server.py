"""RTDE of an emulated UR controller, protocol version 2: bytes in, bytes out, no sockets.

A packet is a size of 2 bytes (which counts itself), a type of 1 byte and the payload; numbers are
big-endian. Source: UR's RTDE guide.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.rtde_fields import COUNT, INPUTS, OUTPUTS, PACKING, Get
from surg_emulators.ur.ur_controller import UrController

HEADER = struct.Struct(">HB")
VERSION_REQUEST, CONTROLLER_VERSION, TEXT, DATA = b"VvMU"
SETUP_OUTPUTS, SETUP_INPUTS, START, PAUSE = b"OISP"
RATE = round(1.0 / DT)
MOST_NAMES = 2048
"""Longest list of names in a recipe [bytes]."""
MOST_RECIPES = 255
EXCEPTION, ERROR, WARNING, INFO = range(4)
"""Levels of text messages."""


def packet(kind: int, payload: bytes) -> bytes:
    """A packet of RTDE."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


@dataclass(frozen=True)
class Recipe:
    """Fields of a data packet in their order.

    Attributes:
        names: The fields.
        types: Their types.
    """

    names: tuple[str, ...]
    types: tuple[str, ...]
    body: struct.Struct = field(init=False)

    def __post_init__(self) -> None:
        codes = "".join(PACKING[code] for code in self.types)
        object.__setattr__(self, "body", struct.Struct(">" + codes))

    def unpack(self, data: bytes) -> dict[str, Any]:
        """Values of the fields by name."""
        values, place, found = self.body.unpack(data), 0, {}
        for name, code in zip(self.names, self.types, strict=True):
            count = COUNT[code]
            part = values[place : place + count]
            found[name] = list(part) if count > 1 else part[0]
            place += count
        return found


class RtdeSession:
    """One connected client.

    Attributes:
        closed: The client broke the protocol: the connection must be closed.
        started: Whether it gets states.
        inputs: Its input recipes by number.
    """

    def __init__(self, controller: UrController) -> None:
        self.closed = self.started = False
        self.inputs: dict[int, Recipe] = {}
        self._controller = controller
        self._buffer = bytearray()
        self._output: Recipe | None = None
        self._get: list[tuple[Get, bool]] = []
        self._divider = 1
        self._answers: dict[int, Callable[[bytes], bytes]] = {
            VERSION_REQUEST: self._request_version,
            CONTROLLER_VERSION: lambda body: packet(
                CONTROLLER_VERSION, struct.pack(">4I", *controller.version)
            ),
            SETUP_OUTPUTS: self._set_up_outputs,
            SETUP_INPUTS: self._set_up_inputs,
            START: self._start,
            PAUSE: self._pause,
            DATA: self._data,
            TEXT: lambda body: b"",
        }

    def receive(self, data: bytes) -> bytes:
        """Take bytes of the client; returns the answers."""
        self._buffer += data
        answers = bytearray()
        while len(self._buffer) >= HEADER.size and not self.closed:
            size, kind = HEADER.unpack_from(self._buffer)
            if size < HEADER.size:  # nobody can tell where the next packet begins
                self.closed = True
                break
            if len(self._buffer) < size:
                break
            body = bytes(self._buffer[HEADER.size : size])
            del self._buffer[:size]
            answer = self._answers.get(kind)
            answers += answer(body) if answer else self._text(f"packet type {kind} is not known")
        if self.closed:
            self._buffer.clear()
        return bytes(answers)

    def output(self) -> bytes:
        """The state of this cycle, where the client wants one."""
        if not self.started or self._output is None or self._controller.cycles % self._divider:
            return b""
        values: list[Any] = []
        for get, several in self._get:
            value = get(self._controller)
            if several:
                values.extend(value)
            else:
                values.append(value)
        body = self._output.body.pack(*values)
        return packet(DATA, b"\x01" + body)

    def leave(self) -> None:
        """Free the client's registers."""
        claims = self._controller.claims
        for name in [name for name, owner in claims.items() if owner is self]:
            del claims[name]
        self.closed, self.started = True, False

    def _text(self, message: str, level: int = ERROR) -> bytes:
        said, source = message.encode("utf-8", "replace")[:255], b"RTDE"
        return packet(
            TEXT, bytes([len(said)]) + said + bytes([len(source)]) + source + bytes([level])
        )

    def _request_version(self, body: bytes) -> bytes:
        wanted = int.from_bytes(body, "big") if len(body) == 2 else 0
        return packet(VERSION_REQUEST, bytes([wanted == 2 and not self.started]))

    def _set_up_outputs(self, body: bytes) -> bytes:
        rate, body = (struct.unpack(">d", body[:8])[0] if len(body) >= 8 else 0.0), body[8:]
        names = _names(body)
        if self.started or names is None or not (math.isfinite(rate) and 0.0 < rate <= RATE):
            why = f"rate {rate}, {len(body)} bytes of names, while started: {self.started}"
            return self._text(f"output recipe refused: {why}") + self._recipe_answer(
                SETUP_OUTPUTS, 0, []
            )
        types = [OUTPUTS[name][0] if name in OUTPUTS else "NOT_FOUND" for name in names]
        valid = "NOT_FOUND" not in types
        self._output = Recipe(tuple(names), tuple(types)) if valid else None
        self._get = (
            [(OUTPUTS[name][1], COUNT[code] > 1) for name, code in zip(names, types, strict=True)]
            if valid
            else []
        )
        self._divider = max(1, round(RATE / rate))
        return self._recipe_answer(SETUP_OUTPUTS, int(valid), types)

    def _set_up_inputs(self, body: bytes) -> bytes:
        names, claims = _names(body), self._controller.claims
        if names is None or len(self.inputs) >= MOST_RECIPES:
            return self._recipe_answer(SETUP_INPUTS, 0, [])
        types = []
        for name in names:
            taken = claims.get(name, self) is not self
            types.append("IN_USE" if taken else INPUTS.get(name, "NOT_FOUND"))
        if {"IN_USE", "NOT_FOUND"} & set(types):
            return self._recipe_answer(SETUP_INPUTS, 0, types)
        claims.update(dict.fromkeys(names, self))
        number = len(self.inputs) + 1
        self.inputs[number] = Recipe(tuple(names), tuple(types))
        return self._recipe_answer(SETUP_INPUTS, number, types)

    def _recipe_answer(self, kind: int, number: int, types: list[str]) -> bytes:
        return packet(kind, bytes([number]) + ",".join(types).encode())

    def _start(self, body: bytes) -> bytes:
        self.started = self._output is not None or bool(self.inputs)
        return packet(START, bytes([self.started]))

    def _pause(self, body: bytes) -> bytes:
        self.started = False
        return packet(PAUSE, b"\x01")

    def _data(self, body: bytes) -> bytes:
        recipe = self.inputs.get(body[0]) if body else None
        if recipe is None:
            return self._text(f"input recipe {body[0] if body else ''} is not known")
        if len(body) - 1 != recipe.body.size:
            return self._text(
                f"input recipe {body[0]} has {recipe.body.size} bytes, not {len(body) - 1}"
            )
        self._controller.stage(recipe.unpack(body[1:]))
        return b""


def _names(body: bytes) -> list[str] | None:
    """Names of a recipe; None: too long, empty or not ASCII. A comma may follow the last one."""
    if not 0 < len(body) <= MOST_NAMES or not body.isascii():
        return None
    return body.decode("ascii").removesuffix(",").split(",")
