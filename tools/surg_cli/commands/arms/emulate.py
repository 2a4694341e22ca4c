"""`./surg emulate`: the controller of an arm as a program, for tests and for trying things out."""

from __future__ import annotations

import argparse

from surg_cli.host.terminal import Problem, say
from surg_hardware.emulators.ur import ur_emulator


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument("arm", choices=("ur",), help="ur: UR3e, UR5e, UR10e")
    ur_emulator.add_arguments(parser)
    parser.add_argument("--seconds", type=float, help="end after this time (default: Ctrl-C)")


def main(options: argparse.Namespace, command: str) -> int:
    """Serve until Ctrl-C."""
    try:
        emulator = ur_emulator.start(options)
    except (ValueError, OSError) as error:
        raise Problem(f"emulate: {error}", 2) from error
    granted = ur_emulator.ask_real_time()
    say(ur_emulator.greeting(options.address, emulator, granted))
    if not granted:
        say("Without real-time priority its cycles come late under load (ulimit -r).")
    say(f"Mishaps: one per line to port {emulator.ports['control']}; `help` lists them.")
    try:
        emulator.run(options.seconds, tell=say)
    finally:
        emulator.close()
    return 0
