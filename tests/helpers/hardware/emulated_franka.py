"""Emulated Franka arms for tests: in memory on a fake clock, or as a program."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from helpers.hardware.emulated_ur import emulator
from surg_emulators.franka.fci_messages import HEADER, Protocol
from surg_emulators.franka.fci_session import FciSession
from surg_emulators.franka.franka_controller import FrankaController
from surg_emulators.franka.franka_errors import Error
from surg_emulators.franka.franka_robots import FrankaRobot

REST = (0.0,) * 7
JOINT_VELOCITY, JOINT_POSITION = 1, 0
MOVE_SIZE = {5: 56, 10: 113}


@dataclass(frozen=True)
class State:
    """A state's datagram as a client reads it."""

    number: int
    values: dict[str, tuple[float, ...]]
    generator: int
    controller: int
    errors: list[str]
    reflex: list[str]
    mode: int
    success_rate: float

    @staticmethod
    def of(protocol: Protocol, data: bytes) -> State:
        """Read a datagram."""
        number, *values, generator, controller, errors, reflex, mode, rate = protocol.state.unpack(
            data
        )
        found = {name: tuple(values[place]) for name, place in protocol.places.items()}
        names = [[error.name for error in Error if flags[error]] for flags in (errors, reflex)]
        return State(number, found, generator, controller, *names, mode, rate)


class Client:
    """A client without sockets: each cycle it answers the last state.

    Args:
        controller: The emulated arm.
    """

    def __init__(self, controller: FrankaController) -> None:
        self.controller, self.protocol = controller, controller.protocol
        self.session = FciSession(controller)
        self.answers: list[tuple[str, str]] = []
        self._codes = {name: code for code, name in self.protocol.commands.items()}

    def ask(self, name: str, body: bytes = b"") -> str:
        """Send a request; the status of the answer, empty where it comes later."""
        data = HEADER.pack(self._codes[name], 1, HEADER.size + len(body)) + body
        answers = self._read(self.session.receive(data))
        return answers[0][1] if answers else ""

    def connect(self, port: int = 4000) -> str:
        """Connect with the version that the arm speaks."""
        return self.ask("connect", struct.pack("<HH", self.protocol.version, port))

    def move(self, generator: int = JOINT_VELOCITY, controller: int = 0) -> str:
        """Ask for a motion."""
        body = struct.pack("<II", controller, generator)
        return self.ask("move", body.ljust(MOVE_SIZE[self.protocol.version], b"\0"))

    def datagram(
        self, dq: Sequence[float] = REST, q: Sequence[float] = REST, last: bool = False
    ) -> bytes:
        """The command that answers the newest state."""
        rest = struct.pack("<16d6d2d??7d", *(0.0,) * 24, False, last, *REST)
        data = struct.pack("<Q7d7d", self.controller.number, *q, *dq) + rest
        return data.ljust(self.protocol.command.size, b"\0")

    def step(
        self, dq: Sequence[float] = REST, q: Sequence[float] = REST, last: bool = False
    ) -> None:
        """One cycle with a command."""
        self.controller.receive(self.datagram(dq, q, last))
        self.wait(1)

    def wait(self, cycles: int) -> None:
        """Cycles without a command."""
        for _ in range(cycles):
            self.controller.cycle()
            self.answers += self._read(self.session.output())

    def state(self) -> State:
        """The newest state, through its datagram."""
        return State.of(self.protocol, self.controller.state())

    def _read(self, data: bytes) -> list[tuple[str, str]]:
        found = []
        while data:
            code, _, size = HEADER.unpack_from(data)
            name = self.protocol.commands[code]
            known = self.protocol.statuses.get(name, ("success", "not_possible", "invalid"))
            found.append((name, known[data[HEADER.size]]))
            data = data[size:]
        return found


def connected(robot: FrankaRobot, q: Sequence[float] | None = None) -> Client:
    """A client that has connected to an arm at rest."""
    controller = FrankaController(robot) if q is None else FrankaController(robot, q=q)
    client = Client(controller)
    assert client.connect() == "success"
    return client


def moving(robot: FrankaRobot, generator: int = JOINT_VELOCITY) -> Client:
    """A client whose motion has begun, at rest."""
    client = connected(robot)
    assert client.move(generator) == "started"
    client.step(q=client.controller.motion.q_d)
    return client


def ramp(robot: FrankaRobot, cycles: int, joint: int = 0) -> list[list[float]]:
    """Velocities of a joint that speeds up with half of the acceleration and jerk limits."""
    most, jerk = 0.5 * robot.acceleration[joint], 0.5 * robot.jerk[joint]
    found, speed, rate = [], 0.0, 0.0
    for _ in range(cycles):
        rate = min(most, rate + jerk * 0.001)
        speed += rate * 0.001
        found.append([speed if each == joint else 0.0 for each in range(7)])
    return found


@contextmanager
def program(kind: str, log: Path, *options: str) -> Iterator[str]:
    """The emulator as a process with the usual ports; yields its address."""
    module = "surg_emulators.franka.franka_emulator"
    with emulator(module, log, kind, *options) as address:
        yield address
