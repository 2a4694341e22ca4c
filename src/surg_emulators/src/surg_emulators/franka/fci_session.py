"""Command port of an emulated Franka controller: one client's bytes in, answers out, no sockets."""

from __future__ import annotations

import struct
from collections.abc import Callable

from surg_emulators.franka import fci_messages as fci
from surg_emulators.franka.franka_controller import FrankaController
from surg_emulators.franka.robot_model import urdf

LARGEST = 1024
"""No request is larger [bytes]."""


class FciSession:
    """One connected client.

    Attributes:
        closed: The client broke the protocol: the connection must be closed.
        udp_port: Where its states go; 0 until it has connected.
    """

    def __init__(self, controller: FrankaController) -> None:
        self.closed, self.udp_port = False, 0
        self._controller, self._protocol = controller, controller.protocol
        self._numbers = {name: number for number, name in self._protocol.commands.items()}
        self._buffer = bytearray()
        self._pending: dict[str, int] = {}
        self._answers: dict[str, Callable[[int, bytes], bytes]] = {
            "connect": self._connect,
            "move": self._move,
            "stop_move": self._stop_move,
            "automatic_error_recovery": self._recover,
            "load_model_library": self._load_model_library,
            "get_robot_model": self._get_robot_model,
            "get_cartesian_limit": self._get_cartesian_limit,
        }

    def receive(self, data: bytes) -> bytes:
        """Take bytes of the client; returns the answers."""
        self._buffer += data
        answers = bytearray()
        while len(self._buffer) >= fci.HEADER.size and not self.closed:
            command, number, size = fci.HEADER.unpack_from(self._buffer)
            if not fci.HEADER.size <= size <= LARGEST:
                self._break(f"a message of {size} bytes")
            elif len(self._buffer) < size:
                break
            else:
                body = bytes(self._buffer[fci.HEADER.size : size])
                del self._buffer[:size]
                answers += self._answer(command, number, body)
        if self.closed:
            self._buffer.clear()
        return bytes(answers)

    def output(self) -> bytes:
        """Answers that became due in this cycle."""
        answers = bytearray()
        while self._controller.answers:
            name, status = self._controller.answers.popleft()
            if name in self._pending:
                answers += self._status(name, self._pending.pop(name), status)
        return bytes(answers)

    def _answer(self, command: int, number: int, body: bytes) -> bytes:
        name = self._protocol.commands.get(command)
        if name is None:
            return self._break(f"command {command} is not known")
        if (name == "connect") == bool(self.udp_port):
            return self._break(f"{name} out of order")
        answer = self._answers.get(name)
        if answer is not None:
            return answer(number, body)
        layout = self._protocol.bodies[name]
        if len(body) != layout.size:
            return self._break(f"{name} with {len(body)} bytes, must have {layout.size}")
        return self._status(name, number, self._controller.set(name, layout.unpack(body)))

    def _break(self, text: str) -> bytes:
        self._controller.say(f"connection closed: {text}")
        self.closed = True
        return b""

    def _message(self, name: str, number: int, status: str, body: bytes = b"") -> bytes:
        code = bytes([self._protocol.status(name, status)])
        return fci.message(self._numbers[name], number, code + body)

    def _status(self, name: str, number: int, status: str) -> bytes:
        if status not in ("success", "started", "preempted"):
            self._controller.say(f"{name}: {status}")
        return self._message(name, number, status)

    def _connect(self, number: int, body: bytes) -> bytes:
        if len(body) != fci.CONNECT.size:
            return self._break(f"connect with {len(body)} bytes")
        version, port = fci.CONNECT.unpack(body)
        own = struct.pack("<H", self._protocol.version)
        if version != self._protocol.version:
            self._controller.say(f"a client speaks version {version}, not {self._protocol.version}")
            return self._message("connect", number, "incompatible", own)
        self.udp_port = port
        return self._message("connect", number, "success", own)

    def _move(self, number: int, body: bytes) -> bytes:
        if len(body) < self._protocol.move_size:
            return self._break(f"move with {len(body)} bytes")
        controller, generator, *_ = fci.MOVE.unpack_from(body)
        if controller >= len(fci.CONTROLLERS) or generator >= len(fci.MODE_NAMES):
            self._controller.say(f"move: unknown generator {generator} or controller {controller}")
            return self._status("move", number, "invalid_argument")
        status = self._controller.move(controller, fci.MODE_NAMES[generator])
        if status == "started":
            self._pending["move"] = number
        return self._status("move", number, status)

    def _stop_move(self, number: int, body: bytes) -> bytes:
        return self._status("stop_move", number, self._controller.stop_move())

    def _recover(self, number: int, body: bytes) -> bytes:
        status = self._controller.recover()
        if not status:
            self._pending["automatic_error_recovery"] = number
            return b""
        return self._status("automatic_error_recovery", number, status)

    def _load_model_library(self, number: int, body: bytes) -> bytes:
        self._controller.say("the emulator has no model library: libfcimodels is the maker's")
        return self._message("load_model_library", number, "error")

    def _get_robot_model(self, number: int, body: bytes) -> bytes:
        model = urdf(self._controller.robot).encode()
        return self._message("get_robot_model", number, "success", model)

    def _get_cartesian_limit(self, number: int, body: bytes) -> bytes:
        pose = (0.0,) * 3 + tuple(float(k % 5 == 0) for k in range(16))
        no_wall = struct.pack("<19d?", *pose, False)
        return self._message("get_cartesian_limit", number, "success", no_wall)
