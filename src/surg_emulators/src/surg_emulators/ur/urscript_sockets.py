"""Sockets of a URScript program: connections that it opens to this machine, by name.

Only loopback addresses are reached, as the emulator itself serves no others. Nothing here waits:
a read that lacks data suspends its thread.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
from typing import Any

from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.urscript_syntax import ScriptError
from surg_emulators.ur.urscript_threads import Builtin, Wait

CONNECT = 1.0
"""Longest wait for a connection [s]; a peer on this machine answers at once."""
OPENING = 10
"""Cycles that it takes to connect. Assumed: the peer has accepted one before the next comes."""
MOST_SOCKETS, MOST_INTEGERS = 10, 255
CHUNK = 1 << 16
BURST = 10
"""Every tenth read takes a cycle though its data lie there, as reading takes time. Assumed."""
DEFAULT = "socket_0"


class ScriptSockets:
    """The open sockets of one controller."""

    def __init__(self) -> None:
        self._open: dict[str, socket.socket] = {}
        self._read: dict[str, bytes] = {}
        self._reads = 0

    def functions(self) -> dict[str, Builtin]:
        """Name -> function of URScript."""
        return {
            "socket_open": self.open,
            "socket_close": self.close,
            "socket_read_binary_integer": self.read_integers,
            "socket_send_int": self.send_integer,
        }

    def open(self, address: Any, port: Any, name: Any = DEFAULT) -> Wait:
        """Connect; the answer is whether somebody listens there."""
        connected = self._connect(address, port, name)
        return Wait(OPENING, answer=lambda: connected)

    def _connect(self, address: Any, port: Any, name: Any) -> bool:
        if not ipaddress.ip_address(str(address)).is_loopback:
            raise ScriptError(f"socket_open: {address}: only loopback is reached here")
        self.close(name)
        if len(self._open) >= MOST_SOCKETS:
            return False
        try:
            peer = socket.create_connection((str(address), int(port)), CONNECT)
        except OSError:
            return False
        peer.setblocking(False)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._open[str(name)], self._read[str(name)] = peer, b""
        return True

    def close(self, name: Any = DEFAULT) -> None:
        """Close one; without it nothing happens."""
        if (peer := self._open.pop(str(name), None)) is not None:
            peer.close()

    def close_all(self) -> None:
        """Close every socket, as the end of the program does."""
        for name in list(self._open):
            self.close(name)

    def read_integers(self, count: Any, name: Any = DEFAULT, timeout: Any = 2.0) -> Any:
        """Read big-endian integers: their count and themselves, or 0 and nothing of use.

        Args:
            count: Of integers.
            name: Of the socket.
            timeout: Longest wait [s]; 0 waits without end.
        """
        if not 0 < int(count) <= MOST_INTEGERS:
            raise ScriptError(f"socket_read_binary_integer: {count!r} integers")
        size = 4 * int(count)
        left = round(float(timeout) / DT) if timeout > 0 else -1

        def over() -> bool:
            nonlocal left
            left -= 1
            return self._has(str(name), size) or left == 0 or str(name) not in self._open

        def answer() -> list[int]:
            if not self._has(str(name), size):
                return [0] * (1 + int(count))
            data, rest = self._read[str(name)][:size], self._read[str(name)][size:]
            self._read[str(name)] = rest
            return [int(count), *struct.unpack(f">{int(count)}i", data)]

        self._reads += 1
        at_once = over() and self._reads % BURST
        return answer() if at_once else Wait(1, over, answer=answer)

    def send_integer(self, value: Any, name: Any = DEFAULT) -> bool:
        """Send one big-endian integer; whether the socket took it."""
        peer = self._open.get(str(name))
        try:
            return peer is not None and peer.send(struct.pack(">i", int(value))) == 4
        except (OSError, struct.error):
            return False

    def _has(self, name: str, size: int) -> bool:
        """Whether so many bytes have come; a peer that has left closes the socket."""
        peer = self._open.get(name)
        while peer is not None and len(self._read[name]) < size:
            try:
                data = peer.recv(CHUNK)
            except BlockingIOError:
                return False
            except OSError:
                data = b""
            if not data:
                self.close(name)
                return False
            self._read[name] += data
        return peer is not None
