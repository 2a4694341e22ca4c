"""`./surg emulate`: the controller of an arm as a program, for tests and for trying things out."""

from __future__ import annotations

import argparse
import subprocess
from pathlib import Path

from surg_cli.host import cells
from surg_cli.host.terminal import CliError, say
from surg_cli.robots import drive_service
from surg_cli.robots.emulated_arms import MODELS
from surg_emulators import emulator_program
from surg_emulators.emulator_ports import PortedEmulator
from surg_emulators.franka import franka_emulator
from surg_emulators.ur import ur_emulator
from surg_emulators.ur.ur_controller import VERSIONS
from surg_hardware.drive.drive_file import drive_of

ROBOTS = {robot: (kind, model) for kind, of in MODELS.items() for robot, model in of.items()}
"""Robot -> its emulator, and its name at the maker's."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.epilog = (
        "Ports, serial number, joint angles, a start without power and a record of every cycle "
        "are options of the programs surg_emulators.ur.ur_emulator and "
        "surg_emulators.franka.franka_emulator."
    )
    add = parser.add_argument
    robots = ", ".join(ROBOTS)
    add("robot", metavar="ROBOT", help=f"{robots}, or a cell: its arm's address, serial, home")
    add("--arm", metavar="NAME", help="of the cell (default: its first)")
    add("--address", metavar="IP", help="loopback address without a cell (default: 127.0.0.1)")
    add("--faults", type=Path, metavar="FILE", help="faults, one per line: [at SECONDS] NAME ...")
    add("--polyscope", choices=tuple(VERSIONS), default="5", help="of a UR (default: 5)")


def main(options: argparse.Namespace, command: str) -> int:
    """Serve until Ctrl-C."""
    kind, program = _of_robot(options) if options.robot in ROBOTS else _of_cell(options)
    if kind != "ur" and options.polyscope != "5":
        raise CliError(f"emulate {options.robot}: --polyscope is of a UR", 2)
    try:
        emulator = _start(kind, program)
    except (ValueError, OSError) as error:
        raise CliError(f"emulate: {error}", 2) from error
    granted = emulator_program.ask_real_time()
    drive = None if options.robot in ROBOTS else _start_drive(options)
    say(emulator_program.greeting(emulator, granted))
    if not granted:
        say("Without real-time priority its cycles come late under load (ulimit -r).")
    say(f"Faults: one per line to port {emulator.ports['control']}; `help` lists them.")
    try:
        emulator.run(None, tell=say)
    finally:
        emulator.close()
        if drive is not None:
            drive.communicate()  # it ends with its input
    return 0


def _start(kind: str, options: argparse.Namespace) -> PortedEmulator:
    return ur_emulator.start(options) if kind == "ur" else franka_emulator.start(kind, options)


def _start_drive(options: argparse.Namespace) -> subprocess.Popen[bytes] | None:
    """The servos of the arm's instrument as a program, where its drive is an emulated one."""
    cell = cells.load(cells.find(options.robot))
    name = cells.chosen_arms(cell, options.arm)[0]
    if name not in cells.with_drive(cell):
        return None
    drive = drive_of(cell, name)
    if not drive.emulated:
        return None
    return subprocess.Popen(drive_service.emulator_words(drive), stdin=subprocess.PIPE)


def _of_robot(options: argparse.Namespace) -> tuple[str, argparse.Namespace]:
    """The emulator of a robot, and the options of that program.

    Raises:
        CliError: ``--arm`` is given.
    """
    if options.arm is not None:
        raise CliError(f"emulate {options.robot}: --arm {options.arm} needs a cell", 2)
    kind, model = ROBOTS[options.robot]
    return kind, _program(options, options.address or "127.0.0.1", model)


def _of_cell(options: argparse.Namespace) -> tuple[str, argparse.Namespace]:
    """The emulator of a cell's arm, and the options of that program.

    Raises:
        CliError: There is no such cell or arm, or nothing emulates it.
    """
    try:
        folder = cells.find(options.robot)
    except CliError as problem:
        raise CliError(f"no robot of {', '.join(ROBOTS)}; {problem}", 2) from None
    if options.address is not None:
        raise CliError("emulate: --address: the cell states it", 2)
    cell = cells.load(folder)
    name = cells.chosen_arms(cell, options.arm)[0]
    arm = cell.arms[name]
    place = f"{folder / 'cell.yaml'}: arms.{name}"
    if arm.hardware is None or not arm.hardware.emulated:
        raise CliError(
            f"{place}.hardware.address: must be on loopback (127.x.x.x) to be emulated", 2
        )
    if arm.robot.name not in ROBOTS:
        raise CliError(f"{place}.robot: {arm.robot.name!r}; allowed: {', '.join(ROBOTS)}", 2)
    kind, model = ROBOTS[arm.robot.name]
    hardware = arm.hardware
    return kind, _program(options, hardware.address, model, hardware.serial, list(arm.robot.home))


def _program(
    options: argparse.Namespace,
    address: str,
    model: str,
    serial: str | None = None,
    q: list[float] | None = None,
) -> argparse.Namespace:
    """The options of an emulator's own program; those that are not stated have its defaults."""
    parser = argparse.ArgumentParser()
    emulator_program.add_arguments(parser)
    given = parser.parse_args([])
    given.address, given.model, given.serial, given.q = address, model, serial, q
    given.faults, given.polyscope = options.faults, options.polyscope
    return given
