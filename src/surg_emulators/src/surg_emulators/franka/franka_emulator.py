"""A Franka controller as a program: the emulated controller behind its TCP port and its datagrams.

States go to the client's UDP port each millisecond; its commands come back to the port that they
came from. When this program itself is late, its clock falls behind: a packet that counts as lost is
the client's fault or a fault's.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import socket
import sys
from collections.abc import Sequence

from surg_emulators.datagram_faults import DatagramChannel
from surg_emulators.emulator_ports import CONTROL, Connection, EmulatorSession, PortedEmulator
from surg_emulators.emulator_program import parse_ports, prepare, serve
from surg_emulators.fault_lines import Kind
from surg_emulators.franka import franka_faults
from surg_emulators.franka.fci_session import FciSession
from surg_emulators.franka.franka_controller import FrankaController
from surg_emulators.franka.franka_robots import HOME, ROBOTS
from surg_emulators.franka.generator_motion import DT

SERIAL = "295341-1325001"
PORTS = {"command": 1337, CONTROL: 29990}
"""Service -> port. `control` takes faults and exists only here."""
SHORTEST = 0.8
"""Share of a period that a client has at least, where the emulator was late."""
DOWN = 2.0
"""Time without any port during a reboot [s]; an arm's is longer."""
LARGEST, MOST_AT_ONCE = 4096, 1000
"""Bytes of a datagram that are read; datagrams that are read in a row."""


class FrankaEmulator(PortedEmulator):
    """The controller behind its ports.

    Args:
        controller: The controller.
        address: Loopback address to listen on.
        ports: Service -> port; 0 takes a free one. A service that is missing has its usual port.
    """

    def __init__(
        self,
        controller: FrankaController,
        address: str = "127.0.0.1",
        ports: dict[str, int] | None = None,
    ) -> None:
        self.controller = controller
        self._states, self._commands = DatagramChannel(1), DatagramChannel(2)
        self._udp: socket.socket | None = None
        self._client = ""
        self._booted_at = -1.0
        super().__init__(controller, DT, address, PORTS | (ports or {}), SHORTEST)

    def cycle(self) -> None:
        """One cycle of the controller: command, answers, next state."""
        if self._udp is not None and not self._stalled:
            self._receive_datagram(self._udp)  # what came while this program was late
        self._begin_cycle()
        if self._booted_at >= 0.0 and self._now >= self._booted_at + DOWN:
            self._booted_at = -1.0
            self._listen("command")
        self.controller.cycle()
        for each in list(self._connections):
            if isinstance(each.session, FciSession):
                self._send(each, each.session.output())
                if each.session.udp_port:
                    self._send_state(self.controller.state(), each.session.udp_port)

    # Datagrams -----------------------------------------------------------------------------------

    def channels(self, direction: str = "both") -> list[DatagramChannel]:
        """Both directions of the network, or one of `states` and `commands`."""
        found = {"states": [self._states], "commands": [self._commands]}
        return found.get(direction, [self._states, self._commands])

    def _send_state(self, state: bytes, port: int) -> None:
        self._states.stalled = self._stalled
        for data in self._states.pass_on(state):
            self._send_datagram(data, port)

    def _send_datagram(self, data: bytes, port: int) -> None:
        if self._udp is None:
            self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._udp.bind((self.address, 0))
            self._udp.setblocking(False)
            self._datagrams = [self._udp]
        with contextlib.suppress(OSError):  # its port is closed: the connection will tell
            self._udp.sendto(data, (self._client, port))

    def _receive_datagram(self, receiver: socket.socket) -> None:
        for _ in range(MOST_AT_ONCE):
            try:
                data = receiver.recv(LARGEST)
            except OSError:
                return
            for each in self._commands.pass_on(data):
                self.controller.receive(each)

    def send_garbage(self) -> None:
        """Send a datagram that is no state."""
        for each in self._connections:
            if isinstance(each.session, FciSession) and each.session.udp_port:
                self._send_datagram(b"\x07" * 40, each.session.udp_port)

    # Connections ---------------------------------------------------------------------------------

    def _session(self, service: str) -> EmulatorSession:
        return FciSession(self.controller)

    def _most(self, service: str) -> int:
        return 1 if service == "command" else super()._most(service)

    def _welcome(self, connection: Connection) -> None:
        self._client = connection.socket.getpeername()[0]

    def _left(self, connection: Connection) -> None:
        if isinstance(connection.session, FciSession):
            self.controller.disconnect()
            for channel in self.channels():
                channel.release()
            if self._udp is not None:
                self._udp.close()
                self._udp, self._datagrams = None, []

    def _kinds(self) -> dict[str, Kind]:
        return franka_faults.kinds(self)

    def reboot(self) -> None:
        """Start the controller again: no port for a while, then the brakes are closed."""
        self.reset_connections()
        self._close_listener("command")
        self.controller.boot()
        self._booted_at = self._now

    # For people ----------------------------------------------------------------------------------

    @property
    def title(self) -> str:
        """What is emulated, and for which clients."""
        robot = self.controller.robot
        return f"{robot.title} for libfranka {robot.library} (version {robot.version})"

    def status(self) -> str:
        """The controller's state as one line of JSON."""
        c = self.controller
        active = c.active
        return json.dumps(
            {
                "time": round(self._now, 3),
                "mode": c.mode.name,
                "errors": sorted(error.name for error in c.errors),
                "motion": active.generator if active else "",
                "success_rate": round(c.success_rate, 2),
                "lost_in_a_row": active.lost if active else 0,
                "sent_late": c.sent_late,
                "serial": c.serial,
                "q": c.motion.q,
                "dq": c.motion.dq,
                "clients": [each.service for each in self._connections],
                "message": c.messages[-1] if c.messages else "",
            }
        )

    def _columns(self) -> Sequence[str]:
        names = ("q_d", "dq_d", "ddq_d", "q", "dq")
        return ("mode", "lost", *(f"{name}{joint}" for name in names for joint in range(1, 8)))

    def _row(self) -> Sequence[str]:
        c, m = self.controller, self.controller.motion
        lost = c.active.lost if c.active else 0
        joints = (*m.q_d, *m.dq_d, *m.ddq_d, *m.q, *m.dq)
        return (str(int(c.mode)), str(lost), *(f"{value:.9f}" for value in joints))


def start(kind: str, options: argparse.Namespace) -> FrankaEmulator:
    """The emulator that the options describe.

    Args:
        kind: `fer` or `fr3`.
        options: Of `add_arguments`.

    Raises:
        ValueError: An option is wrong; states which.
        OSError: A port is taken, or a file cannot be read.
    """
    q = options.q or HOME
    if len(q) != 7:
        raise ValueError(f"--q: {len(q)} joint angles; a Franka arm has 7")
    controller = FrankaController(ROBOTS[kind], options.serial or SERIAL, q, ready=not options.off)
    ports = parse_ports(options.ports, PORTS)
    emulator = FrankaEmulator(controller, options.address, ports)
    prepare(emulator, options)
    return emulator


def main(words: Sequence[str] | None = None) -> int:
    """Run the emulator until it is interrupted."""

    def declare(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("arm", choices=tuple(ROBOTS))

    return serve(__doc__, declare, lambda options: start(options.arm, options), words)


if __name__ == "__main__":
    sys.exit(main())
