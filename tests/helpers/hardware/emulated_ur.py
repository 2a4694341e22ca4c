"""Emulated UR arms for tests: in memory on a fake clock, or as a program with ports of its own."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from surg_cli.host import paths
from surg_emulators.ur.rtde_fields import COUNT, PACKING
from surg_emulators.ur.rtde_server import RtdeSession
from surg_emulators.ur.ur_controller import UrController
from surg_emulators.ur.ur_emulator import UrEmulator

SOURCES = paths.ROOT / "src" / "surg_hardware" / "src"
QD_REGISTERS = tuple(f"input_double_register_{n}" for n in range(24, 30))
FOLLOW = """
def follow():
  qd = [0, 0, 0, 0, 0, 0]
  thread drive():
    while True:
      speedj(qd, ACCELERATION, 0.002)
    end
  end
  run drive()
  while True:
    number = read_input_integer_register(24)
    index = 0
    while index < 6:
      qd[index] = read_input_float_register(24 + index)
      index = index + 1
    end
    write_output_integer_register(24, number)
    sync()
  end
end
"""
"""Follows velocities in registers 24 to 29 and answers their number."""


def follow(acceleration: float = 40.0) -> str:
    """The following program with its acceleration [rad/s^2]."""
    return FOLLOW.replace("ACCELERATION", str(acceleration))


class Client:
    """An RTDE client without sockets.

    Args:
        session: The server's side.
    """

    def __init__(self, session: RtdeSession) -> None:
        self.session = session
        self.types: list[str] = []
        self.names: list[str] = []
        self.inputs: dict[int, list[str]] = {}

    def ask(self, kind: str, body: bytes = b"") -> list[tuple[str, bytes]]:
        """Send a packet; the answers as type and payload."""
        return list(packets(self.session.receive(made(kind, body))))

    def set_up(
        self, outputs: Sequence[str], inputs: Sequence[str] = (), rate: float = 500.0
    ) -> int:
        """Protocol version 2, both recipes, start; returns the number of the input recipe."""
        assert self.ask("V", b"\x00\x02") == [("V", b"\x01")]
        ((_, answer),) = self.ask("O", struct.pack(">d", rate) + ",".join(outputs).encode())
        self.names, self.types = list(outputs), answer[1:].decode().split(",")
        assert answer[0] == 1, answer
        number = 0
        if inputs:
            ((_, answer),) = self.ask("I", ",".join(inputs).encode())
            number = answer[0]
            assert number > 0, answer
            self.inputs[number] = answer[1:].decode().split(",")
        assert self.ask("S") == [("S", b"\x01")]
        return number

    def send(self, number: int, *values: Any) -> list[tuple[str, bytes]]:
        """One data packet."""
        codes = "".join(PACKING[code] for code in self.inputs[number])
        return self.ask("U", bytes([number]) + struct.pack(">" + codes, *values))

    def state(self) -> dict[str, Any]:
        """The state of this cycle; empty: none is due."""
        data = self.session.output()
        return self.unpack(data) if data else {}

    def unpack(self, data: bytes) -> dict[str, Any]:
        """A state from its packet."""
        ((kind, body),) = packets(data)
        assert kind == "U"
        values = list(struct.unpack(">" + "".join(PACKING[t] for t in self.types), body[1:]))
        found: dict[str, Any] = {}
        for name, code in zip(self.names, self.types, strict=True):
            part = [values.pop(0) for _ in range(COUNT[code])]
            found[name] = part if COUNT[code] > 1 else part[0]
        return found


def made(kind: str, body: bytes = b"") -> bytes:
    """A packet of RTDE."""
    return struct.pack(">Hc", 3 + len(body), kind.encode()) + body


def packets(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Packets in a stream, as type and payload."""
    while data:
        size = struct.unpack(">H", data[:2])[0]
        assert 3 <= size <= len(data)
        yield chr(data[2]), data[3:size]
        data = data[size:]


def primary_parts(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Message type, sub-package type and payload of a primary stream."""
    while data:
        size, kind = struct.unpack(">IB", data[:5])
        body, data = data[5:size], data[size:]
        if kind != 16:
            yield kind, body[9], body[10:]
            continue
        while body:
            length, part = struct.unpack(">IB", body[:5])
            yield kind, part, body[5:length]
            body = body[length:]


def cycle(controller: UrController, client: Client | None = None) -> dict[str, Any]:
    """One cycle; the state that the client gets in it."""
    controller.advance()
    state = client.state() if client is not None else {}
    controller.execute()
    return state


def settle(controller: UrController, seconds: float) -> None:
    """Let time pass [s]."""
    for _ in range(round(seconds * 500)):
        cycle(controller)


_numbers = iter(range(1, 250))


def free_address() -> str:
    """A loopback address that no other test of this machine uses."""
    return f"127.{64 + os.getpid() % 64}.{os.getpid() // 64 % 250}.{next(_numbers)}"


OF_BOTH = pytest.mark.parametrize("polyscope", ["5", "x"])
"""PolyScope 5 and PolyScope X."""


def with_polyscope(version: str) -> list[str]:
    """Options of a controller with PolyScope 5 or X; a skip where X's port 80 is not to be had."""
    lowest = int(Path("/proc/sys/net/ipv4/ip_unprivileged_port_start").read_text("ascii"))
    if version == "x" and os.geteuid() and lowest > 80:
        pytest.skip("PolyScope X has its orders on port 80, which only root may open here")
    return ["--polyscope", version]


@contextmanager
def program(log: Path, *options: str) -> Iterator[str]:
    """The emulator as a process with the usual ports; yields its address."""
    with emulator("surg_emulators.ur.ur_emulator", log, *options) as address:
        yield address


@contextmanager
def emulator(module: str, log: Path, *words: str) -> Iterator[str]:
    """An emulator's module as a process at an address of its own, which it yields."""
    address = free_address()
    command = [sys.executable, "-m", module, *words, "--address", address]
    env = os.environ | {"PYTHONPATH": f"{SOURCES}:{os.environ.get('PYTHONPATH', '')}".rstrip(":")}
    with log.open("w") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=env)
        try:
            wait_for(address, 29990)
            yield address
        finally:
            process.terminate()
            process.wait(10.0)


def wait_for(address: str, port: int, seconds: float = 10.0) -> None:
    """Wait until a port answers."""
    end = time.monotonic() + seconds
    while True:
        try:
            socket.create_connection((address, port), timeout=1.0).close()
            return
        except OSError:
            assert time.monotonic() < end, f"{address}:{port} does not answer"
            time.sleep(0.02)


def fault(address: str, line: str) -> str:
    """A line to the control port; its answer."""
    with socket.create_connection((address, 29990), timeout=5.0) as control:
        control.sendall(f"{line}\n".encode())
        return control.makefile().readline().strip()


@contextmanager
def in_process(
    controller: UrController, ports: dict[str, int] | None = None
) -> Iterator[UrEmulator]:
    """An emulator behind the usual ports of a free address, or others, run by a thread."""
    emulator = UrEmulator(controller, free_address(), ports)
    thread = threading.Thread(target=emulator.run, daemon=True)
    thread.start()
    try:
        yield emulator
    finally:
        emulator.stopped = True
        thread.join(5.0)
        emulator.close()
