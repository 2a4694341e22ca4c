"""The controller of a UR arm as a program: the emulated controller behind its TCP ports.

Its cycle follows the machine's clock. Only loopback addresses are served.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence

from surg_emulators.emulator_ports import CONTROL, Connection, EmulatorSession, PortedEmulator
from surg_emulators.emulator_program import parse_ports, prepare, serve
from surg_emulators.fault_lines import Kind
from surg_emulators.ur import ur_faults
from surg_emulators.ur.dashboard_server import GREETING, DashboardSession
from surg_emulators.ur.dh_kinematics import TABLES
from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.primary_server import PrimarySession
from surg_emulators.ur.robot_api_server import RobotApiSession
from surg_emulators.ur.rtde_server import RtdeSession
from surg_emulators.ur.ur_controller import HOME, VERSIONS, UrController

MODELS = tuple(TABLES)
SERIAL = "20225500001"
PORTS = {
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "script": 30003,
    "rtde": 30004,
    CONTROL: 29990,
}
"""Service -> its port on an arm. `script` is the real-time interface; here it takes programs but
sends no states. `control` takes faults and exists only here."""
ROBOT_API = {"api": 80}
"""What PolyScope X has in the place of the dashboard server."""
PORTS_X = ROBOT_API | {name: port for name, port in PORTS.items() if name != "dashboard"}
DOWN, FIRST_RTDE, RESTART = 1.0, 2.0, 0.5
"""Reboot: no port answers, RTDE answers, RTDE is gone again [s]."""


class UrEmulator(PortedEmulator):
    """The controller behind its ports.

    Args:
        controller: The controller.
        address: Loopback address to listen on.
        ports: Service -> port; 0 takes a free one. A service that is missing has its usual port.
    """

    def __init__(
        self,
        controller: UrController,
        address: str = "127.0.0.1",
        ports: dict[str, int] | None = None,
    ) -> None:
        self.controller = controller
        self._booted_at = -1.0
        known = PORTS_X if controller.version[:1] == VERSIONS["x"][:1] else PORTS
        super().__init__(controller, DT, address, known | (ports or {}))

    # One cycle -------------------------------------------------------------------------------

    def cycle(self) -> None:
        """One cycle of the controller, without waiting for anything."""
        self._begin_cycle()
        self._follow_boot()
        self.controller.advance()
        for connection in list(self._connections):
            session = connection.session
            if isinstance(session, RtdeSession | PrimarySession | RobotApiSession):
                self._send(connection, session.output())
        self.controller.execute()

    def _columns(self) -> Sequence[str]:
        joints = (f"{name}{joint}" for name in ("q", "target_qd") for joint in range(1, 7))
        return ("robot_mode", "safety_mode", "runtime", *joints)

    def _row(self) -> Sequence[str]:
        c = self.controller
        modes = (c.robot_mode, c.safety_mode, c.runtime)
        joints = (*c.motion.actual_q, *c.motion.qd)
        return (*(str(int(mode)) for mode in modes), *(f"{value:.9f}" for value in joints))

    # For people ------------------------------------------------------------------------------

    @property
    def title(self) -> str:
        """What is emulated."""
        return self.controller.model

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

    def reboot(self) -> None:
        """Start the controller again: first no port answers, then RTDE starts twice."""
        self.reset_connections()
        self.controller.boot()
        self._booted_at = self._now
        for service in self._services:
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

    @property
    def _services(self) -> list[str]:
        """What the arm itself has."""
        return [service for service in self.ports if service != CONTROL]

    def _follow_boot(self) -> None:
        """Open and close ports while the controller boots."""
        if self._booted_at < 0.0:
            return
        since = self._now - self._booted_at
        restarting = DOWN + FIRST_RTDE <= since < DOWN + FIRST_RTDE + RESTART
        if since < DOWN:
            return
        for service in self._services:
            if service == "rtde" and restarting:
                self.reset_connections(("rtde",))
                self._close_listener("rtde")
            elif service not in self._listeners:
                self._listen(service)
        if since >= DOWN + FIRST_RTDE + RESTART:
            self._booted_at = -1.0

    # Sockets ---------------------------------------------------------------------------------

    def _kinds(self) -> dict[str, Kind]:
        return ur_faults.kinds(self)

    def _welcome(self, connection: Connection) -> None:
        if connection.service == "dashboard":
            self._send(connection, GREETING)
        elif isinstance(connection.session, PrimarySession):
            self._send(connection, connection.session.greeting())

    def _left(self, connection: Connection) -> None:
        if isinstance(connection.session, RtdeSession):
            connection.session.leave()

    def _session(self, service: str) -> EmulatorSession:
        if service == "rtde":
            return RtdeSession(self.controller)
        if service == "dashboard":
            return DashboardSession(self.controller)
        if service == "api":
            return RobotApiSession(self.controller)
        return PrimarySession(self.controller, service)


def start(options: argparse.Namespace) -> UrEmulator:
    """The emulator that the options describe.

    Raises:
        ValueError: An option is wrong; states which.
        OSError: A port is taken, or a file cannot be read.
    """
    q = options.q or HOME
    if len(q) != 6:
        raise ValueError(f"--q: {len(q)} joint angles; a UR has 6")
    controller = UrController(
        options.model,
        options.serial or SERIAL,
        q,
        ready=not options.off,
        polyscope=options.polyscope,
    )
    ports = parse_ports(options.ports, PORTS_X if options.polyscope == "x" else PORTS)
    emulator = UrEmulator(controller, options.address, ports)
    prepare(emulator, options)
    return emulator


def main(words: Sequence[str] | None = None) -> int:
    """Run the emulator until it is interrupted."""

    def declare(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--model", choices=MODELS, default="UR5e", help="default: UR5e")
        parser.add_argument("--polyscope", choices=tuple(VERSIONS), default="5", help="default: 5")

    return serve(__doc__, declare, start, words)


if __name__ == "__main__":
    sys.exit(main())
