"""Emulated arms of a run: their controllers as programs beside the nodes, and their start."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from surg_cli.graph import follow
from surg_cli.graph.processes import Supervisor
from surg_cli.host import cells, paths
from surg_cli.host.terminal import CliError
from surg_cli.robots import drive_service
from surg_cli.robots.robot_request import RobotRequests
from surg_emulators.emulator_ports import CONTROL
from surg_emulators.ur import ur_emulator
from surg_hardware.drive.drive_file import drive_of

MODELS = {
    "ur": {model.lower(): model for model in ur_emulator.MODELS},
    "fer": {"panda": "Panda"},
    "fr3": {"fr3": "FR3"},
}
"""Emulator -> the robots of cells that it can be, and their names at the maker's."""
DRIVE_TRIES = 3
"""Homings of an emulated drive: where the machine is busy, its servos answer late."""
ASK_AGAIN_S = 0.5
"""[s] At first the robot's states are too young for a start."""


def refuse_real(arms: Mapping[str, Any], where: str) -> None:
    """Check that every arm with hardware is an emulated one.

    Raises:
        CliError: One is a real arm, or none that we emulate.
    """
    for name, arm in arms.items():
        if arm.hardware is not None and not arm.hardware.emulated:
            raise CliError(
                f"{where}: {name} is a real arm at {arm.hardware.address}: a person starts it, "
                "with ./surg up; see docs/guide/link_ur.md",
                2,
            )
        if arm.hardware is not None:
            _kind(name, arm, where)


def _kind(name: str, arm: Any, where: str) -> str:
    """The emulator that an arm needs."""
    for kind, models in MODELS.items():
        if arm.robot.name in models:
            return kind
    raise CliError(f"{where}: {name}: nothing emulates the robot {arm.robot.name!r}", 2)


class EmulatedArms:
    """The emulated arms of a cell, beside the nodes of a run.

    Args:
        cell: Folder of the cell.
        arms: Arm -> what the cell says of it; those without hardware are left out.
    """

    def __init__(self, cell: Path, arms: Mapping[str, Any]) -> None:
        self._cell = cell
        self._arms = {name: arm for name, arm in arms.items() if arm.hardware is not None}
        self._links: RobotRequests | None = None
        self._asked = 0.0  # steady clock [s]

    def start(self, supervisor: Supervisor) -> None:
        """Start the emulators and wait until they answer.

        Raises:
            CliError: One does not come up, such as when its address is taken.
        """
        tools = f"{paths.ROOT / 'tools'}:{supervisor.env.get('PYTHONPATH', '')}".rstrip(":")
        env = {"SURG_READY": "1", "PYTHONPATH": tools}
        cell = str(self._cell)
        for name in self._arms:
            words = ["emulate", cell, "--arm", name]
            argv = [sys.executable, "-s", "-m", "surg_cli", *words]
            supervisor.start(f"/{name}/emulator", argv, extra_env=env)

        def silent() -> list[str]:
            arms = self._arms.items()
            waiting = [name for name, arm in arms if not _answers(arm.hardware.address)]
            return [f"the emulator of {name}" for name in waiting]

        follow.wait_for(silent, supervisor, lambda part, text: None)

    def obey(self, supervisor: Supervisor, update: Callable[[float | None, str], None]) -> None:
        """Ask the robots to start until they obey; nothing moves by it.

        Raises:
            CliError: One does not within the time of a system's start.
        """
        if self._arms:
            self._links, self._asked = RobotRequests(tuple(self._arms)), time.monotonic()
            follow.wait_for(self._ask, supervisor, update)
            self._home_drives()

    def _home_drives(self) -> None:
        """Home emulated drives, whose instruments harm nobody.

        Raises:
            CliError: A drive is a real one, or it does not home.
        """
        cell = cells.load(self._cell)
        for arm in cells.with_drive(cell):
            if not drive_of(cell, arm).emulated:
                raise CliError(f"{arm}: its drive is a real one: a person homes it, after surg up")
            request = drive_service.DriveRequest(arm)
            whys = [request.home() for _ in range(DRIVE_TRIES) if not request.homed]
            if not request.homed:
                raise CliError(f"{arm}: {whys[-1]}")

    def ask_again(self) -> None:
        """Ask those that have stopped obeying since; only as long as no arm was homed."""
        if self._links is not None:
            self._ask()

    def _ask(self) -> list[str]:
        """Ask those that do not obey, not too often; returns which, and what they say."""
        assert self._links is not None
        conditions = {arm: self._links.condition(arm) for arm in self._arms}
        waiting = [arm for arm, condition in conditions.items() if condition != "ACTIVE"]
        if time.monotonic() - self._asked > ASK_AGAIN_S:
            self._asked = time.monotonic()
            for arm in waiting:
                self._links.send(arm, "start")
        return [f"the robot of {arm} ({conditions[arm] or 'silent'})" for arm in waiting]


def _answers(address: str) -> bool:
    try:
        socket.create_connection((address, ur_emulator.PORTS[CONTROL]), 0.2).close()
    except OSError:
        return False
    return True
