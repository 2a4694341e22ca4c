"""An emulator as a program: its options, its real-time priority, and the run until a signal."""

from __future__ import annotations

import argparse
import gc
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from surg_emulators.emulator_ports import PortedEmulator
from surg_emulators.fault_lines import FaultError

PRIORITY = 60


def ask_real_time() -> bool:
    """Ask for real-time priority; whether it was granted. What is there now is never collected."""
    gc.freeze()  # a collection of all that was imported takes 20 ms and more
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        return False
    return True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that every emulator has."""
    add = parser.add_argument
    add("--address", default="127.0.0.1", help="loopback address (default: 127.0.0.1)")
    add("--ports", metavar="NAME=PORT,...", default="", help="other ports than the arm's; 0: any")
    add("--faults", type=Path, metavar="FILE", help="faults, one per line: [at SECONDS] NAME ...")
    add("--record", type=Path, metavar="FILE", help="write modes and joints of every cycle as CSV")
    add("--serial", help="serial number")
    add("--q", type=float, nargs="+", metavar="RAD", help="joint angles at the start")
    add("--off", action="store_true", help="begin with the power off (ur) or the brakes closed")


def parse_ports(text: str, known: Mapping[str, int]) -> dict[str, int]:
    """Ports of `--ports`, on top of the usual ones.

    Raises:
        ValueError: A part is no known name with a port.
    """
    found = dict(known)
    for part in text.split(",") if text else []:
        name, _, port = part.partition("=")
        if name not in known or not port.isdigit() or int(port) > 65535:
            raise ValueError(f"--ports {part!r}: must be NAME=PORT with a name of {_said(known)}")
        found[name] = int(port)
    return found


def _said(ports: Mapping[str, int]) -> str:
    return ", ".join(f"{name}={port}" for name, port in ports.items())


def prepare(emulator: PortedEmulator, options: argparse.Namespace) -> None:
    """Read the faults and open the record that the options name.

    Raises:
        ValueError: One of the files is wrong; the emulator has been closed.
    """
    try:
        if options.faults is not None:
            emulator.faults(options.faults.read_text("utf-8"))
        if options.record is not None:
            emulator.record(options.record.open("w", encoding="utf-8"))
    except (FaultError, OSError) as error:
        emulator.close()
        raise ValueError(f"{options.faults or options.record}: {error}") from error


def greeting(emulator: PortedEmulator, real_time: bool) -> str:
    """What a person reads first: arm, address, ports."""
    granted = "with" if real_time else "without"
    where = f"{emulator.address}: {_said(emulator.ports)}"
    return f"Emulated {emulator.title} on {where}; {granted} real-time priority"


def serve(
    description: str | None,
    declare: Callable[[argparse.ArgumentParser], object],
    start: Callable[[argparse.Namespace], PortedEmulator],
    words: Sequence[str] | None,
) -> int:
    """Run an emulator as a program until it is interrupted; returns the exit code.

    Args:
        description: For `--help`.
        declare: Declares the options that only this emulator has.
        start: Makes the emulator of the options.
        words: Of the command line; None: the program's own.
    """
    parser = argparse.ArgumentParser(description=description)
    declare(parser)
    add_arguments(parser)
    try:
        emulator = start(parser.parse_args(words))
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(greeting(emulator, ask_real_time()), flush=True)
    signal.signal(signal.SIGTERM, lambda *_: setattr(emulator, "stopped", True))
    try:
        emulator.run(tell=lambda text: print(text, flush=True))
    except KeyboardInterrupt:
        pass
    finally:
        emulator.close()
    return 0
