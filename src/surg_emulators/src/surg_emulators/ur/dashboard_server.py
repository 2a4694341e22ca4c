"""Dashboard server of an emulated UR controller: a line in, a line out, no sockets.

Wording of the answers: UR's page on the e-Series dashboard server.
"""

from __future__ import annotations

from collections.abc import Callable

from surg_emulators.ur.robot_states import RobotMode, Runtime
from surg_emulators.ur.ur_controller import UrController

GREETING = b"Connected: Universal Robots Dashboard Server\n"
LONGEST_LINE = 4096
FOLDERS = ("/programs/", "/ursim/programs/")
"""Where programs lie."""
LOCAL = (
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode "
    "and reconnect to port 29999"
)
FAMILY = {"UR3e": "UR3", "UR5e": "UR5", "UR10e": "UR10"}
"""`get robot model` does not tell the e-Series."""


class DashboardSession:
    """One connected client.

    Attributes:
        closed: The connection must be closed.
    """

    def __init__(self, controller: UrController) -> None:
        self.closed = False
        self._controller = controller
        self._remote = controller.remote  # an arm wants a new connection after a change, too
        self._buffer = bytearray()
        c = controller
        self._asks: dict[str, Callable[[str], str]] = {
            "robotmode": lambda rest: f"Robotmode: {RobotMode(c.robot_mode).name}",
            "safetymode": lambda rest: f"Safetymode: {c.safety_mode.name}",
            "safetystatus": lambda rest: f"Safetystatus: {c.safety_mode.name}",
            "running": lambda rest: f"Program running: {_truth(c.runtime == Runtime.PLAYING)}",
            "programstate": lambda rest: f"{c.program_state} {c.loaded or '<unnamed>'}",
            "get loaded program": lambda rest: (
                f"Loaded program: /programs/{c.loaded}" if c.loaded else "No program loaded"
            ),
            "isprogramsaved": lambda rest: f"true {c.loaded or '<unnamed>'}",
            "polyscopeversion": lambda rest: f"URSoftware {self._version()} (Mar 22 2022)",
            "version": lambda rest: self._version(),
            "get serial number": lambda rest: c.serial,
            "get robot model": lambda rest: FAMILY[c.model],
            "get operational mode": lambda rest: "AUTOMATIC" if c.remote else "MANUAL",
            "is in remote control": lambda rest: _truth(c.remote),
            "addtolog": lambda rest: self._log(rest),
            "close popup": lambda rest: "closing popup",
            "popup": lambda rest: "showing popup",
            "savelog": lambda rest: "Log saved to disk",
            "quit": lambda rest: self._quit(),
        }
        self._orders: dict[str, Callable[[str], str]] = {
            "power on": lambda rest: _after(c.power_on, "Powering on"),
            "power off": lambda rest: _after(c.power_off, "Powering off"),
            "brake release": lambda rest: _after(c.release_brakes, "Brake releasing"),
            "play": lambda rest: "Starting program" if c.play() else "Failed to execute: play",
            "pause": lambda rest: "Pausing program" if c.pause() else "Failed to execute: pause",
            "stop": lambda rest: _after(c.stop, "Stopped"),
            "load installation": lambda rest: f"Loading installation: {rest}",
            "load": lambda rest: (
                f"Loading program: {rest}" if self._load(rest) else f"File not found: {rest}"
            ),
            "unlock protective stop": lambda rest: self._unlock(),
            "restart safety": lambda rest: _after(c.release, "Restarting safety"),
            "close safety popup": lambda rest: "closing safety popup",
            "clear operational mode": lambda rest: "operational mode is no longer controlled",
            "set operational mode": lambda rest: f"Operational mode '{rest}' is set",
            "shutdown": lambda rest: _after(c.power_off, "Shutting down"),
        }

    def receive(self, data: bytes) -> bytes:
        """Take bytes of the client; returns the answers."""
        self._buffer += data
        answers = bytearray()
        while b"\n" in self._buffer and not self.closed:
            line, _, rest = self._buffer.partition(b"\n")
            self._buffer = bytearray(rest)
            answers += self.answer(line.decode("utf-8", "replace").strip()).encode() + b"\n"
        self.closed |= len(self._buffer) > LONGEST_LINE
        return bytes(answers)

    def answer(self, line: str) -> str:
        """The answer to one command."""
        words = line.lower()
        for commands in (self._asks, self._orders):
            for name, command in commands.items():
                if words == name or words.startswith(name + " "):
                    if commands is self._orders and not (self._remote and self._controller.remote):
                        return LOCAL
                    return command(line[len(name) :].strip())
        return f"could not understand: '{line}'"

    def _version(self) -> str:
        return ".".join(str(part) for part in self._controller.version)

    def _load(self, path: str) -> bool:
        """Load a program by its name, or by its path on an arm or on the maker's simulator."""
        folder = next((each for each in FOLDERS if path.startswith(each)), "")
        return self._controller.load(path.removeprefix(folder))

    def _log(self, text: str) -> str:
        if not text:
            return "No log message to add"
        self._controller.say(text)
        return "Added log message"

    def _quit(self) -> str:
        self.closed = True
        return "Disconnected"

    def _unlock(self) -> str:
        if self._controller.unlock():
            return "Protective stop releasing"
        return (
            "Cannot unlock protective stop until 5s after occurrence. "
            "Always inspect cause of protective stop before unlocking"
        )


def _truth(value: bool) -> str:
    return "true" if value else "false"


def _after(action: Callable[[], object], said: str) -> str:
    action()
    return said
