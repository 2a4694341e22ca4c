"""`./surg emulate`: the controller of an arm as a program, for tests and for trying things out."""

from __future__ import annotations

import argparse
from pathlib import Path

from surg_cli.host import cells
from surg_cli.host.terminal import Problem, say
from surg_cli.robots.emulated_arms import MODELS
from surg_emulators import emulator_ports
from surg_emulators.emulator_ports import PortedEmulator
from surg_emulators.franka import franka_emulator
from surg_emulators.ur import ur_emulator


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument(
        "arm", choices=tuple(MODELS), help="ur: UR3e, UR5e, UR10e; fer: Panda; fr3: FR3"
    )
    parser.add_argument("--cell", help="be the arm of this cell: its address, serial, model, home")
    parser.add_argument(
        "--arm", dest="name", metavar="NAME", help="of the cell; default: its first"
    )
    emulator_ports.add_arguments(parser)
    parser.add_argument("--model", choices=ur_emulator.MODELS, help="of a UR; default: UR5e")
    parser.add_argument("--seconds", type=float, help="end after this time (default: Ctrl-C)")


def main(options: argparse.Namespace, command: str) -> int:
    """Serve until Ctrl-C."""
    if options.cell is not None:
        _be_of_cell(options, cells.find(options.cell))
    try:
        emulator = _start(options)
    except (ValueError, OSError) as error:
        raise Problem(f"emulate: {error}", 2) from error
    granted = emulator_ports.ask_real_time()
    say(emulator_ports.greeting(emulator, granted))
    if not granted:
        say("Without real-time priority its cycles come late under load (ulimit -r).")
    say(f"Faults: one per line to port {emulator.ports['control']}; `help` lists them.")
    try:
        emulator.run(options.seconds, tell=say)
    finally:
        emulator.close()
    return 0


def _start(options: argparse.Namespace) -> PortedEmulator:
    if options.arm != "ur":
        if options.model is not None and options.cell is None:
            raise ValueError(f"--model {options.model}: only `ur` has models")
        return franka_emulator.start(options.arm, options)
    options.model = options.model or "UR5e"
    return ur_emulator.start(options)


def _be_of_cell(options: argparse.Namespace, folder: Path) -> None:
    """Take address, serial, model and home from a cell's arm.

    Raises:
        Problem: The cell has no such arm, or the arm is none that this emulator can be.
    """
    cell = cells.load(folder)
    name = cells.chosen_arms(cell, options.name)[0]
    arm = cell.arms[name]
    models = MODELS[options.arm]
    place = f"{folder / 'cell.yaml'}: arms.{name}"
    if arm.hardware is None or not arm.hardware.emulated:
        raise Problem(
            f"{place}.hardware.address: must be on loopback (127.x.x.x) to be emulated", 2
        )
    if arm.robot.name not in models:
        raise Problem(f"{place}.robot: {arm.robot.name!r}; allowed: {', '.join(models)}", 2)
    options.address, options.serial = arm.hardware.address, arm.hardware.serial
    options.model, options.q = models[arm.robot.name], list(arm.robot.home)
