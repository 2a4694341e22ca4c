"""A client of UR's Real-Time Data Exchange, protocol version 2, as the vendor's guide defines it.

A package is its length (two bytes, big endian, itself included), a letter and a payload.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass

PORT = 30004
VERSION = 2
FREQUENCY = 500.0
"""[1/s] Of the states; e-Series."""

OUTPUTS = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "target_q",
    "robot_mode",
    "safety_status",
    "runtime_state",
    "speed_scaling",
    "target_speed_fraction",
    "robot_status_bits",
    "actual_TCP_pose",
    "actual_TCP_force",
    "tcp_offset",
    "payload",
    "payload_cog",
    "output_int_register_24",
    "output_int_register_25",
)
INPUTS = (
    "input_int_register_24",
    *(f"input_double_register_{number}" for number in range(24, 30)),
)
_FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
_HEADER = struct.Struct(">HB")
_CHUNK = 1 << 16
_REQUEST_VERSION, _MESSAGE = ord("V"), ord("M")
_DATA, _SETUP_OUTPUTS, _SETUP_INPUTS, _START = ord("U"), ord("O"), ord("I"), ord("S")

Values = dict[str, tuple[float, ...]]


class RtdeError(ConnectionError):
    """The peer does not speak RTDE as the guide says, or has closed the connection."""


class RtdeRefused(RtdeError):
    """The robot refuses what this client needs; asking again changes nothing by itself.

    Attributes:
        sentence: What is refused.
        cure: What to do.
    """

    def __init__(self, sentence: str, cure: str) -> None:
        super().__init__(f"{sentence}: {cure}")
        self.sentence, self.cure = sentence, cure


class Decoder:
    """Splits a byte stream into packages. No socket."""

    def __init__(self) -> None:
        self._rest = b""

    def add(self, data: bytes) -> list[tuple[int, bytes]]:
        """The packages that these bytes complete, in order: letter and payload.

        Raises:
            RtdeError: A package states a length that is shorter than its head.
        """
        self._rest += data
        found, at = [], 0
        while at + _HEADER.size <= len(self._rest):
            length, letter = _HEADER.unpack_from(self._rest, at)
            if length < _HEADER.size:
                raise RtdeError(f"a package of {length} bytes; the least is {_HEADER.size}")
            if at + length > len(self._rest):
                break
            found.append((letter, self._rest[at + _HEADER.size : at + length]))
            at += length
        self._rest = self._rest[at:]
        return found


@dataclass(frozen=True)
class Recipe:
    """Fields that go together in one data package, in their order."""

    number: int
    names: tuple[str, ...]
    layout: struct.Struct
    places: tuple[slice, ...]  # of each field among the unpacked values

    @staticmethod
    def of(names: Sequence[str], reply: bytes) -> Recipe:
        """The recipe that the robot has set up.

        Args:
            names: Of the fields that were asked for.
            reply: Payload of the robot's answer: a number, then the types with commas.

        Raises:
            RtdeError: It is no answer to these names.
            RtdeRefused: A field does not exist, or another client owns it.
        """
        types = reply[1:].decode("ascii", "replace").split(",")
        if not reply or len(types) != len(names):
            raise RtdeError(f"{len(types)} types for {len(names)} fields")
        refused = [f"{n} {t}" for n, t in zip(names, types, strict=True) if t not in _FORMATS]
        if refused:
            in_use = any("IN_USE" in each for each in refused)
            cure = (
                "another RTDE client owns these registers: end it" if in_use else "update PolyScope"
            )
            raise RtdeRefused(f"RTDE: {', '.join(refused)}", cure)
        formats = [_FORMATS[each] for each in types]
        places, at = [], 0
        for each in formats:
            count = int(each[:-1] or 1)
            places.append(slice(at, at + count))
            at += count
        return Recipe(reply[0], tuple(names), struct.Struct(">" + "".join(formats)), tuple(places))

    def unpack(self, payload: bytes) -> Values | None:
        """Values by field; None: the package is of another recipe or size."""
        if len(payload) != 1 + self.layout.size or payload[0] != self.number:
            return None
        values = self.layout.unpack_from(payload, 1)
        return {n: values[place] for n, place in zip(self.names, self.places, strict=True)}

    def pack(self, *values: float) -> bytes:
        """A data package with these values, one after another."""
        return package(_DATA, bytes((self.number,)) + self.layout.pack(*values))


def package(letter: int, payload: bytes = b"") -> bytes:
    """A package as bytes."""
    return _HEADER.pack(_HEADER.size + len(payload), letter) + payload


class Rtde:
    """A connection that exchanges `OUTPUTS` and `INPUTS`.

    Args:
        address: Of the robot.
        timeout: Longest wait for the connection, and for each answer of the handshake [s].
        inputs: Whether this client commands; False: it only listens.

    Raises:
        OSError: Nobody answers there.
        RtdeError: The answer is not RTDE (`RtdeRefused`: a field is missing or owned by another).
    """

    def __init__(self, address: str, timeout: float = 1.0, inputs: bool = True) -> None:
        self._decoder = Decoder()
        self._waiting: list[tuple[int, bytes]] = []
        self.messages: list[str] = []
        """Texts that the robot has sent; the reader clears them."""
        self._socket = socket.create_connection((address, PORT), timeout)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            reply = self._ask(_REQUEST_VERSION, struct.pack(">H", VERSION), timeout)
            if reply != b"\x01":
                raise RtdeRefused(
                    f"RTDE: the robot refuses protocol version {VERSION}", "update PolyScope"
                )
            asked = struct.pack(">d", FREQUENCY) + ",".join(OUTPUTS).encode()
            self._outputs = Recipe.of(OUTPUTS, self._ask(_SETUP_OUTPUTS, asked, timeout))
            self._inputs: Recipe | None = None
            if inputs:
                reply = self._ask(_SETUP_INPUTS, ",".join(INPUTS).encode(), timeout)
                self._inputs = Recipe.of(INPUTS, reply)
            if self._ask(_START, b"", timeout) != b"\x01":
                raise RtdeRefused(
                    "RTDE: the robot refuses to start the exchange", "restart the robot"
                )
            self._socket.setblocking(False)
        except BaseException:
            self._socket.close()
            raise

    def fileno(self) -> int:
        """For select."""
        return self._socket.fileno()

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def newest(self) -> Values | None:
        """The newest complete state that has arrived; None: no new one.

        Raises:
            RtdeError: The robot has closed the connection or sends nonsense.
        """
        try:
            while True:
                data = self._socket.recv(_CHUNK)
                if not data:
                    raise RtdeError("the robot has closed the connection")
                self._waiting += self._decoder.add(data)
                if len(data) < _CHUNK:
                    break
        except BlockingIOError:
            pass
        found = None
        for letter, payload in self._waiting:
            if letter == _DATA:
                found = self._outputs.unpack(payload) or found
            else:
                self._note(letter, payload)
        self._waiting = []
        return found

    def send(self, number: int, velocities: Sequence[float]) -> bool:
        """Send a command [rad/s]; returns whether the socket took it.

        Raises:
            OSError: The connection has ended.
        """
        assert self._inputs is not None
        package = self._inputs.pack(number, *velocities)
        try:
            return self._socket.send(package) == len(package)
        except BlockingIOError:
            return False

    def _ask(self, letter: int, payload: bytes, timeout: float) -> bytes:
        """Send a request and wait for its answer; other packages are dropped meanwhile."""
        self._socket.sendall(package(letter, payload))
        deadline = time.monotonic() + timeout
        while True:
            while self._waiting:
                found, answer = self._waiting.pop(0)
                if found == letter:
                    return answer
                self._note(found, answer)
            left = deadline - time.monotonic()
            if left <= 0:
                raise RtdeError(f"no answer to '{chr(letter)}' within {timeout:g} s")
            self._socket.settimeout(left)
            try:
                data = self._socket.recv(_CHUNK)
            except TimeoutError as error:
                raise RtdeError(f"no answer to '{chr(letter)}' within {timeout:g} s") from error
            if not data:
                raise RtdeError("the robot has closed the connection")
            self._waiting += self._decoder.add(data)

    def _note(self, letter: int, payload: bytes) -> None:
        """Keep a text message: its length, itself, and more that is not needed."""
        if letter == _MESSAGE and payload and len(self.messages) < 10:
            self.messages.append(payload[1 : 1 + payload[0]].decode("utf-8", "replace"))
