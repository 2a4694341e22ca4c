"""A UR e-Series controller as a program: the emulated controller behind its TCP ports.

Two faces: in free-run the controller's cycle follows the machine's clock; in lock-step each cycle
waits for the commands that answer the last state. Only loopback addresses are served.
"""

from __future__ import annotations

import argparse
import ipaddress
import json
import os
import select
import signal
import socket
import struct
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TextIO

from surg_hardware.emulators.mishaps import MishapError, Schedule
from surg_hardware.emulators.ur import ur_mishaps
from surg_hardware.emulators.ur.dashboard_server import GREETING, DashboardSession
from surg_hardware.emulators.ur.dh_kinematics import TABLES
from surg_hardware.emulators.ur.joint_motion import DT
from surg_hardware.emulators.ur.primary_server import PrimarySession
from surg_hardware.emulators.ur.rtde_server import RtdeSession
from surg_hardware.emulators.ur.ur_controller import HOME, UrController

MODELS = tuple(TABLES)
PORTS = {
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "script": 30003,
    "rtde": 30004,
    "control": 29990,
}
"""Service -> its port on an arm. `script` is the real-time interface; here it takes programs but
sends no states. `control` takes mishaps and exists only here."""
MOST_CLIENTS = 10
"""Connections per service; an arm refuses further ones too."""
MOST_WAITING = 1 << 16
"""Bytes waiting for a slow client; then whole packets are dropped, as an arm does."""
READ = 1 << 16
LATE = 0.1
"""Further behind its clock than this, the controller skips cycles [s]."""
PRIORITY = 60
DOWN, FIRST_RTDE, RESTART = 1.0, 2.0, 0.5
"""Reboot: no port answers, RTDE answers, RTDE is gone again [s]."""


class Session(Protocol):
    """One service for one client."""

    closed: bool

    def receive(self, data: bytes) -> bytes:
        """Take bytes, return the answers."""


@dataclass
class Connection:
    """A client's socket and its session."""

    service: str
    socket: socket.socket
    session: Session
    waiting: bytearray = field(default_factory=bytearray)
    ending: bool = False  # no more input; closes when everything is sent

    def fileno(self) -> int:
        """For `select`."""
        return self.socket.fileno()


class _ControlSession:
    """Lines of mishaps."""

    def __init__(self, emulator: UrEmulator) -> None:
        self.closed = False
        self._emulator = emulator
        self._buffer = b""

    def receive(self, data: bytes) -> bytes:
        """Take bytes, return the answers."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        self.closed |= len(self._buffer) > 4096
        answers = [self._emulator.mishap(line.decode("utf-8", "replace")) for line in lines]
        return "".join(f"{answer}\n" for answer in answers).encode()


class UrEmulator:
    """The controller behind its ports.

    Args:
        controller: The controller.
        address: Loopback address to listen on.
        ports: Service -> port; 0 takes a free one. A service that is missing has its usual port.
        lock_step: Whether `run` waits for the commands of every cycle.

    Attributes:
        controller: The controller.
        address: Address that it listens on.
        ports: Service -> port that it listens on.
        stopped: Set it to True to end `run`.

    Raises:
        ValueError: The address is not loopback.
        OSError: A port is taken.
    """

    def __init__(
        self,
        controller: UrController,
        address: str = "127.0.0.1",
        ports: dict[str, int] | None = None,
        lock_step: bool = False,
    ) -> None:
        if not ipaddress.ip_address(address).is_loopback:
            raise ValueError(f"address {address}: only loopback (127.0.0.0/8) is allowed")
        self.controller, self.stopped = controller, False
        self.address, self._lock_step = address, lock_step
        self._now = 0.0  # emulated time [s]; goes on through a reboot
        self._period = DT
        self._stalled_until = self._booted_at = -1.0
        self._connections: list[Connection] = []
        self._listeners: dict[str, socket.socket] = {}
        self._record: TextIO | None = None
        self.ports = PORTS | (ports or {})
        try:
            for service in PORTS:
                self._listen(service)
        except OSError:
            self.close()
            raise
        self._schedule = Schedule(ur_mishaps.kinds(self))

    # One cycle -------------------------------------------------------------------------------

    def cycle(self) -> None:
        """One cycle of the controller, without waiting for anything."""
        self._now += DT
        for said in self._schedule.due(self._now):
            self.controller.say(said)
        self._follow_boot()
        self.controller.advance()
        for connection in list(self._connections):
            session = connection.session
            if isinstance(session, RtdeSession | PrimarySession):
                self._send(connection, session.output())
        self.controller.execute()
        if self._record is not None:
            self._write_row(self._record)

    def record(self, file: TextIO) -> None:
        """Write one row per cycle: both clocks, modes, joints."""
        self._record = file
        joints = (f"{name}{joint}" for name in ("q", "target_qd") for joint in range(1, 7))
        head = ("time", "monotonic", "robot_mode", "safety_mode", "runtime", *joints)
        file.write(",".join(head) + "\n")

    def _write_row(self, file: TextIO) -> None:
        c = self.controller
        modes = (c.robot_mode, c.safety_mode, c.runtime)
        row = (
            f"{self._now:.3f},{time.monotonic():.6f}",
            *(str(int(mode)) for mode in modes),
            *(f"{value:.9f}" for value in (*c.motion.actual_q, *c.motion.qd)),
        )
        file.write(",".join(row) + "\n")

    def poll(self, timeout: float = 0.0) -> None:
        """Serve clients until something came or the time [s] is up."""
        if self._now < self._stalled_until:
            control = [each for each in self._connections if each.service == "control"]
            listeners = [self._listeners["control"]] if "control" in self._listeners else []
        else:
            control, listeners = self._connections, list(self._listeners.values())
        readers = [*listeners, *(each for each in control if not each.ending)]
        writers = [each for each in control if each.waiting]
        readable, writable, _ = select.select(readers, writers, [], max(timeout, 0.0))
        for each in readable:
            if isinstance(each, Connection):
                self._receive(each)
            else:
                self._accept(each)
        for each in writable:
            self._flush(each)

    def run(self, seconds: float | None = None, tell: Callable[[str], None] | None = None) -> None:
        """Run until `stopped`, or for some seconds of the controller's time.

        Args:
            seconds: How long; None means without end.
            tell: Called with each message of the controller.
        """
        end = None if seconds is None else self._now + seconds
        told = self.controller.said
        wake = time.monotonic()
        while not self.stopped and (end is None or self._now < end - DT / 2.0):
            self.cycle()
            if tell is not None and (new := self.controller.said - told):
                told = self.controller.said
                for text in list(self.controller.messages)[-new:]:
                    tell(text)
            wake = self._wait(wake)

    def _wait(self, wake: float) -> float:
        """Serve clients until the next cycle; returns when that one is due."""
        if self._lock_step:
            while not self.stopped and not self._all_answered():
                self.poll(0.1)
            return wake
        wake += self._period
        left = wake - time.monotonic()
        if left < -LATE:
            wake, left = time.monotonic(), 0.0
        self.poll(left)
        while (left := wake - time.monotonic()) > 0.0 and not self.stopped:
            self.poll(left)
        return wake

    def _all_answered(self) -> bool:
        """Whether every client that commands has answered the last state."""
        self.poll(0.0)
        sessions = [
            each.session for each in self._connections if isinstance(each.session, RtdeSession)
        ]
        commanding = [each for each in sessions if each.started and each.inputs]
        return bool(commanding) and all(each.answered for each in commanding)

    # Mishaps ---------------------------------------------------------------------------------

    def mishap(self, line: str) -> str:
        """Carry out or schedule a mishap; returns `ok`, an answer, or `error: ...`."""
        return self._schedule.answer(line, self._now)

    def mishaps(self, text: str) -> None:
        """Schedule the lines of a file.

        Raises:
            MishapError: A line is wrong.
        """
        self._schedule.read(text, self._now)

    def mishap_help(self) -> str:
        """All mishaps, one per line."""
        return self._schedule.help()

    def status(self) -> str:
        """The controller's state as one line of JSON."""
        c = self.controller
        return json.dumps(
            {
                "time": round(self._now, 3),
                "robot_mode": c.robot_mode.name,
                "safety_mode": c.safety_mode.name,
                "runtime": c.runtime.name,
                "remote": c.remote,
                "slider": c.slider,
                "guided": c.guided,
                "q": c.motion.actual_q,
                "qd": c.motion.actual_qd,
                "clients": [each.service for each in self._connections],
                "message": c.messages[-1] if c.messages else "",
            }
        )

    def stall(self, seconds: float) -> None:
        """Let the network deliver nothing for some seconds, then everything."""
        self._stalled_until = self._now + seconds

    def drift(self, share: float) -> None:
        """Let the robot's clock run faster by a share."""
        self._period = DT / (1.0 + share)

    def reset_connections(self, services: Sequence[str] = tuple(PORTS)[:-1]) -> None:
        """Reset the connections of some services."""
        for each in [each for each in self._connections if each.service in services]:
            each.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._drop(each)

    def reboot(self) -> None:
        """Start the controller again: first no port answers, then RTDE starts twice."""
        self.reset_connections()
        self.controller.boot()
        self._booted_at = self._now
        for service in tuple(PORTS)[:-1]:
            self._close_listener(service)

    def send_raw(self, data: bytes) -> None:
        """Send bytes to every RTDE client."""
        for each in self._connections:
            if each.service == "rtde":
                self._send(each, data)

    def send_half(self) -> None:
        """Send half of a state to every RTDE client, then reset."""
        for each in self._connections:
            if isinstance(each.session, RtdeSession):
                state = each.session.output()
                self._send(each, state[: len(state) // 2])
                self._flush(each)
        self.reset_connections(("rtde",))

    def _follow_boot(self) -> None:
        """Open and close ports while the controller boots."""
        if self._booted_at < 0.0:
            return
        since = self._now - self._booted_at
        restarting = DOWN + FIRST_RTDE <= since < DOWN + FIRST_RTDE + RESTART
        if since < DOWN:
            return
        for service in tuple(PORTS)[:-1]:
            if service == "rtde" and restarting:
                self.reset_connections(("rtde",))
                self._close_listener("rtde")
            elif service not in self._listeners:
                self._listen(service)
        if since >= DOWN + FIRST_RTDE + RESTART:
            self._booted_at = -1.0

    # Sockets ---------------------------------------------------------------------------------

    def close(self) -> None:
        """Close all connections and ports."""
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
        if sum(each.service == service for each in self._connections) >= MOST_CLIENTS:
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection = Connection(service, client, self._session(service))
        self._connections.append(connection)
        if service == "dashboard":
            self._send(connection, GREETING)
        elif isinstance(connection.session, PrimarySession):
            self._send(connection, connection.session.greeting())

    def _session(self, service: str) -> Session:
        if service == "rtde":
            return RtdeSession(self.controller)
        if service == "dashboard":
            return DashboardSession(self.controller)
        if service == "control":
            return _ControlSession(self)
        return PrimarySession(self.controller, service)

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
        if self._now >= self._stalled_until or connection.service == "control":
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
        if isinstance(connection.session, RtdeSession):
            connection.session.leave()
        connection.socket.close()


def ask_real_time() -> bool:
    """Ask for real-time priority; whether it was granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        return False
    return True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the program."""
    add = parser.add_argument
    add("--address", default="127.0.0.1", help="loopback address (default: 127.0.0.1)")
    add("--ports", metavar="NAME=PORT,...", default="", help=f"other ports than {_said(PORTS)}")
    add("--mishap", type=Path, metavar="FILE", help="mishaps, one per line: [at SECONDS] NAME ...")
    add("--record", type=Path, metavar="FILE", help="write modes and joints of every cycle as CSV")
    add("--model", choices=MODELS, default="UR5e", help="default: UR5e")
    add("--serial", default="20225500001", help="serial number")
    add("--q", type=float, nargs=6, metavar="RAD", help="joint angles at the start")
    add("--off", action="store_true", help="begin with the power off")
    add("--lock-step", action="store_true", help="each cycle waits for the client's commands")


def start(options: argparse.Namespace) -> UrEmulator:
    """The emulator that the options describe.

    Raises:
        ValueError: An option is wrong; states which.
        OSError: A port is taken, or a file cannot be read.
    """
    controller = UrController(
        options.model, options.serial, options.q or HOME, ready=not options.off
    )
    emulator = UrEmulator(controller, options.address, _ports(options.ports), options.lock_step)
    try:
        if options.mishap is not None:
            emulator.mishaps(options.mishap.read_text("utf-8"))
        if options.record is not None:
            emulator.record(options.record.open("w", encoding="utf-8"))
    except (MishapError, OSError) as error:
        emulator.close()
        raise ValueError(f"{options.mishap or options.record}: {error}") from error
    return emulator


def greeting(address: str, emulator: UrEmulator, real_time: bool) -> str:
    """What a person reads first: model, address, ports."""
    granted = "with" if real_time else "without"
    model = emulator.controller.model
    return f"Emulated {model} on {address}: {_said(emulator.ports)}; {granted} real-time priority"


def _ports(text: str) -> dict[str, int]:
    found = {}
    for part in text.split(",") if text else []:
        name, _, port = part.partition("=")
        if name not in PORTS or not port.isdigit() or int(port) > 65535:
            raise ValueError(f"--ports {part!r}: must be NAME=PORT with a name of {_said(PORTS)}")
        found[name] = int(port)
    return found


def _said(ports: dict[str, int]) -> str:
    return ", ".join(f"{name}={port}" for name, port in ports.items())


def main(words: Sequence[str] | None = None) -> int:
    """Run the emulator until it is interrupted."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    options = parser.parse_args(words)
    try:
        emulator = start(options)
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(greeting(options.address, emulator, ask_real_time()), flush=True)
    signal.signal(signal.SIGTERM, lambda *_: setattr(emulator, "stopped", True))
    try:
        emulator.run(tell=lambda text: print(text, flush=True))
    except KeyboardInterrupt:
        pass
    finally:
        emulator.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
