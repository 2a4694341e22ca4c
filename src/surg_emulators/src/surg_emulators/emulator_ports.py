"""An emulated controller behind ports: connections, faults and the clock that every emulator has.

Only loopback addresses are served. The cycles follow the machine's clock.
"""

from __future__ import annotations

import ipaddress
import math
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TextIO

from surg_emulators.fault_lines import Kind, Schedule, number, switch

MOST_CLIENTS = 10
"""Connections per service; an arm refuses further ones too."""
MOST_WAITING = 1 << 16
"""Bytes waiting for a slow client; then whole packets are dropped, as an arm does."""
READ = 1 << 16
LATE = 0.1
"""Further behind its clock than this, the controller skips cycles [s]."""
CONTROL = "control"
"""The service that takes faults."""


class EmulatorSession(Protocol):
    """One service for one client."""

    closed: bool

    def receive(self, data: bytes) -> bytes:
        """Take bytes, return the answers."""


@dataclass
class Connection:
    """A client's socket and its session."""

    service: str
    socket: socket.socket
    session: EmulatorSession
    waiting: bytearray = field(default_factory=bytearray)
    ending: bool = False  # no more input; closes when everything is sent

    def fileno(self) -> int:
        """For `select`."""
        return self.socket.fileno()


class Controller(Protocol):
    """What every emulated controller has: messages for people, and what its states fake.

    ``faked`` are values in place of the truth: ``q`` of every joint [rad], ``mode``, and by how
    much its clock is ``back`` [s].
    """

    messages: deque[str]
    said: int
    faked: dict[str, float]

    def say(self, text: str) -> None:
        """A message."""


class _ControlSession:
    """Lines of faults."""

    def __init__(self, answer: Callable[[str], str]) -> None:
        self.closed = False
        self._answer = answer
        self._buffer = b""

    def receive(self, data: bytes) -> bytes:
        """Take bytes, return the answers."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        self.closed |= len(self._buffer) > 4096
        answers = [self._answer(line.decode("utf-8", "replace")) for line in lines]
        return "".join(f"{answer}\n" for answer in answers).encode()


class PortedEmulator:
    """A controller behind its ports; a kind of arm adds its sessions and its cycle.

    Args:
        controller: The controller.
        period: Of one cycle [s].
        address: Loopback address to listen on.
        ports: Service -> port; 0 takes a free one.
        shortest: Share of the period that a late cycle leaves its clients at least.

    Attributes:
        address: That it listens on.
        ports: Service -> port that it listens on.
        stopped: Set it to True to end `run`.

    Raises:
        ValueError: The address is not loopback.
        OSError: A port is taken.
    """

    def __init__(
        self,
        controller: Controller,
        period: float,
        address: str,
        ports: Mapping[str, int],
        shortest: float = 0.0,
    ) -> None:
        if not ipaddress.ip_address(address).is_loopback:
            raise ValueError(f"address {address}: only loopback (127.0.0.0/8) is allowed")
        self._device, self._dt = controller, period
        self.stopped = False
        self.address = address
        self._now = 0.0  # emulated time [s]; goes on through a reboot
        self._period, self._shortest = period, shortest
        self._stalled_until = -1.0
        self._connections: list[Connection] = []
        self._listeners: dict[str, socket.socket] = {}
        self._datagrams: list[socket.socket] = []
        self._record: TextIO | None = None
        self.ports = dict(ports)
        try:
            for service in self.ports:
                self._listen(service)
        except OSError:
            self.close()
            raise
        self._schedule = Schedule({**self._kinds(), **self._common_kinds()})

    # What a kind of arm adds -----------------------------------------------------------------

    def cycle(self) -> None:
        """One cycle of the controller, without waiting for anything."""
        raise NotImplementedError

    @property
    def title(self) -> str:
        """What is emulated, for people."""
        raise NotImplementedError

    def status(self) -> str:
        """The controller's state as one line of JSON."""
        raise NotImplementedError

    def _columns(self) -> Sequence[str]:
        """Names of a record's columns."""
        raise NotImplementedError

    def _row(self) -> Sequence[str]:
        """The record's row of this cycle."""
        raise NotImplementedError

    def _kinds(self) -> dict[str, Kind]:
        """Faults that only this arm has."""
        raise NotImplementedError

    def _session(self, service: str) -> EmulatorSession:
        """A new client's session."""
        raise NotImplementedError

    def _welcome(self, connection: Connection) -> None:
        """A client has connected."""

    def _left(self, connection: Connection) -> None:
        """A client has left."""

    def _receive_datagram(self, receiver: socket.socket) -> None:
        """A datagram waits."""

    # Clock --------------------------------------------------------------------------------

    def run(self, seconds: float | None = None, tell: Callable[[str], None] | None = None) -> None:
        """Run until `stopped`, or for some seconds of the controller's time.

        Args:
            seconds: How long; None means without end.
            tell: Called with each message of the controller.
        """
        end = None if seconds is None else self._now + seconds
        told = self._device.said
        wake = time.monotonic()
        while not self.stopped and (end is None or self._now < end - self._dt / 2.0):
            self.cycle()
            self._write_row()
            if tell is not None and (new := self._device.said - told):
                told = self._device.said
                for text in list(self._device.messages)[-new:]:
                    tell(text)
            wake = self._wait(wake)

    def record(self, file: TextIO) -> None:
        """Write both clocks and the state of every cycle of `run` as CSV."""
        self._record = file
        file.write(",".join(("time", "monotonic", *self._columns())) + "\n")

    def _write_row(self) -> None:
        if self._record is not None:
            row = (f"{self._now:.3f}", f"{time.monotonic():.6f}", *self._row())
            self._record.write(",".join(row) + "\n")

    def _begin_cycle(self) -> None:
        """Advance the emulated time and carry out the faults that are due."""
        self._now += self._dt
        for said in self._schedule.due(self._now):
            self._device.say(said)

    def _wait(self, wake: float) -> float:
        """Serve clients until the next cycle; returns when that one is due."""
        now = time.monotonic()
        wake += self._period
        if wake < now - LATE:
            wake = now
        until = max(wake, now + self._shortest * self._period)
        self.poll(until - now)
        while (left := until - time.monotonic()) > 0.0 and not self.stopped:
            self.poll(left)
        return wake

    # Faults that every arm has --------------------------------------------------------------

    def fault(self, line: str) -> str:
        """Carry out or schedule a fault; returns `ok`, an answer, or `error: ...`."""
        return self._schedule.answer(line, self._now)

    def faults(self, text: str) -> None:
        """Schedule the lines of a file.

        Raises:
            FaultError: A line is wrong.
        """
        self._schedule.read(text, self._now)

    def fault_help(self) -> str:
        """All faults, one per line."""
        return self._schedule.help()

    def _common_kinds(self) -> dict[str, Kind]:
        """Of people, network and clock, and states that are wrong."""
        device = self._device  # what it fakes is another dictionary after a reboot

        def stall(seconds: str) -> None:
            self._stalled_until = self._now + number(seconds, "stall", 0.0, 60.0)

        def drift(share: str) -> None:
            self._period = self._dt / (1.0 + number(share, "drift", -0.05, 0.05))

        def nan(on: str = "on") -> None:
            device.faked.update(q=math.nan) if switch(on) else device.faked.pop("q", None)

        def mode(word: str) -> None:
            if word == "off":
                device.faked.pop("mode", None)
            else:
                device.faked["mode"] = number(word, "mode", 0, 127)

        def clock_back(seconds: str) -> None:
            device.faked["back"] = number(seconds, "clock_back", 0.0, 1e6)

        return {
            "status": Kind(self.status, "", "answers with mode, joints and more"),
            "help": Kind(self.fault_help, "", "answers with all faults"),
            "stall": Kind(stall, "SECONDS", "the network delivers nothing, then all at once"),
            "drift": Kind(drift, "SHARE", "the robot's clock runs this much faster"),
            "reset": Kind(self.reset_connections, "", "all connections are reset"),
            "nan": Kind(nan, "[on|off]", "the joint positions are not numbers"),
            "mode": Kind(mode, "NUMBER|off", "states hold this robot mode, such as 99"),
            "clock_back": Kind(clock_back, "SECONDS", "the clock of the states jumps back"),
        }

    def reset_connections(self, services: Sequence[str] = ()) -> None:
        """Reset the connections of some services; without names: of all but the control port."""
        chosen = services or tuple(name for name in self.ports if name != CONTROL)
        for each in [each for each in self._connections if each.service in chosen]:
            each.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._drop(each)

    # Sockets --------------------------------------------------------------------------------

    @property
    def _stalled(self) -> bool:
        return self._now < self._stalled_until

    def poll(self, timeout: float = 0.0) -> None:
        """Serve clients until something came or the time [s] is up."""
        served: list[Connection] = self._connections
        listeners, datagrams = list(self._listeners.values()), self._datagrams
        if self._stalled:
            served = [each for each in served if each.service == CONTROL]
            listeners = [self._listeners[CONTROL]] if CONTROL in self._listeners else []
            datagrams = []
        # Clients that leave go before clients that come: a service may take only one.
        readers = [*(each for each in served if not each.ending), *datagrams, *listeners]
        writers = [each for each in served if each.waiting]
        readable, writable, _ = select.select(readers, writers, [], max(timeout, 0.0))
        for each in readable:
            if isinstance(each, Connection):
                self._receive(each)
            elif each in self._datagrams:
                self._receive_datagram(each)
            else:
                self._accept(each)
        for each in writable:
            self._flush(each)

    def close(self) -> None:
        """Close all connections, ports and the record."""
        for each in list(self._connections):
            self._drop(each)
        for service in list(self._listeners):
            self._close_listener(service)
        if self._record is not None:
            self._record.close()
            self._record = None

    def _listen(self, service: str) -> None:
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((self.address, self.ports[service]))
            listener.listen()
        except OSError as error:
            listener.close()
            where = f"{self.address}:{self.ports[service]} ({service})"
            raise OSError(error.errno, f"{where}: {error.strerror}") from error
        listener.setblocking(False)
        self.ports[service] = listener.getsockname()[1]
        self._listeners[service] = listener

    def _close_listener(self, service: str) -> None:
        if service in self._listeners:
            self._listeners.pop(service).close()

    def _accept(self, listener: socket.socket) -> None:
        try:
            client = listener.accept()[0]
        except OSError:
            return
        service = next(name for name, each in self._listeners.items() if each is listener)
        if sum(each.service == service for each in self._connections) >= self._most(service):
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        control = service == CONTROL
        session = _ControlSession(self.fault) if control else self._session(service)
        connection = Connection(service, client, session)
        self._connections.append(connection)
        if not control:
            self._welcome(connection)

    def _most(self, service: str) -> int:
        """Connections that a service serves at a time."""
        return MOST_CLIENTS

    def _receive(self, connection: Connection) -> None:
        try:
            data = connection.socket.recv(READ)
        except BlockingIOError:
            return
        except OSError:
            self._drop(connection)
            return
        if not data:
            self._drop(connection)
            return
        self._send(connection, connection.session.receive(data))
        if connection.session.closed and connection in self._connections:
            self._flush(connection)
            self._drop(connection)

    def _send(self, connection: Connection, data: bytes) -> None:
        if not data or len(connection.waiting) + len(data) > MOST_WAITING:
            return
        connection.waiting += data
        if not self._stalled or connection.service == CONTROL:
            self._flush(connection)

    def _flush(self, connection: Connection) -> None:
        try:
            sent = connection.socket.send(connection.waiting)
        except BlockingIOError:
            return
        except OSError:
            self._drop(connection)
            return
        del connection.waiting[:sent]

    def _drop(self, connection: Connection) -> None:
        if connection in self._connections:
            self._connections.remove(connection)
            self._left(connection)
        connection.socket.close()
