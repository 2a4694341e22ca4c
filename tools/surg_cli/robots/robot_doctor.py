"""`./surg robot CELL doctor`: what would keep a cell's real arms from moving, with cures."""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from surg_cli.graph.roles import Route, routes
from surg_cli.host import cells
from surg_cli.host.terminal import CliError
from surg_hardware import checkup, driver_checkup
from surg_hardware.checkup import Finding
from surg_hardware.ur import ur_checkup

EXAMINERS = {"ur": ur_checkup.examine}
"""Name of a link -> its part of the check-up; that of any other is done by its driver."""
MEASURED_S = 10.0
"""Length of each measurement [s]."""


def findings(name: str, only: str | None, seconds: float) -> list[Finding]:
    """Everything about the real or emulated arms of a cell, by measurements of some seconds.

    Nothing moves.

    Raises:
        CliError: There is no such cell or arm.
    """
    folder = cells.find(name)
    try:
        cell = cells.load(folder)
    except CliError as problem:
        return [Finding("cell", str(problem), False, "correct the file, then ask again")]
    found = [Finding("cell", f"{folder / 'cell.yaml'} is valid")]
    for arm in cells.chosen_arms(cell, only):
        lines = _of_arm(cell, cell.arms[arm], seconds)
        found += [
            Finding(
                f"{arm}: {line.what}",
                line.text,
                line.good,
                line.cure.replace("robot CELL", f"robot {folder.name}"),
            )
            for line in lines
        ]
    return found


def _of_arm(cell: Any, arm: Any, seconds: float) -> list[Finding]:
    if arm.hardware is None:
        return [Finding("link", f"{arm.link!r} has no hardware to examine", None)]
    address, emulated = arm.hardware.address, arm.hardware.emulated
    lines = [
        checkup.real_time_finding(arm.hardware.realtime, emulated),
        *checkup.calibration_findings(arm, datetime.date.today()),
    ]
    if not emulated:
        table = routes(Path("/proc/net/route").read_text("utf-8"))
        lines.append(cable(address, table, _plugged))
    lines += EXAMINERS.get(arm.link, driver_checkup.examine)(arm, seconds)
    return lines + (of_drive(cell, arm.name) if arm.hardware.tool_link == "drive" else [])


def of_drive(cell: Any, arm: str) -> list[Finding]:
    """What is good and bad about the drive of an arm's instrument."""
    from surg_core import ConfigError
    from surg_hardware.drive import drive_checkup
    from surg_hardware.drive.drive_file import drive_of

    try:
        return drive_checkup.examine(drive_of(cell, arm))
    except ConfigError as problem:
        return [Finding("drive", str(problem), False, "correct the file, then ask again")]


def cable(address: str, table: Sequence[Route], plugged: Any) -> Finding:
    """Whether the robot hangs on an interface of its own, and its cable is plugged in.

    Args:
        address: Of the robot.
        table: The machine's routes.
        plugged: Interface -> whether it has a carrier.
    """
    there = ipaddress.IPv4Address(address)
    ways = sorted((r for r in table if there in r.network), key=lambda r: r.network.prefixlen)
    own = "give an interface of this machine an address in the robot's network, without a gateway"
    if not ways:
        return Finding("cable", f"no interface leads to {address}", False, own)
    way = ways[-1]
    if int(way.gateway):
        return Finding("cable", f"{address} lies behind the gateway {way.gateway}", False, own)
    if any(int(r.gateway) for r in table if r.interface == way.interface):
        text = f"{way.interface} has a gateway too: other machines can reach the robot"
        return Finding("cable", text, False, "use an interface for the robot alone")
    if not plugged(way.interface):
        return Finding("cable", f"{way.interface} has no carrier", False, "plug the cable in")
    return Finding("cable", f"{way.interface}, without a gateway")


def _plugged(interface: str) -> bool:
    try:
        return Path(f"/sys/class/net/{interface}/carrier").read_text("ascii").strip() == "1"
    except OSError:  # the interface is down
        return False
