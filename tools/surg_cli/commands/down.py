"""`./surg down`: end what `./surg up` started."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal

from surg_cli.graph import processes, running
from surg_cli.host.option_types import tcp_port
from surg_cli.host.terminal import CliError, say

# SIGINT lets it stop its nodes in order; after SIGKILL its children end with it.
STAGES = ((signal.SIGINT, 20.0), (signal.SIGKILL, 5.0))


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument("--port", type=tcp_port, metavar="P", help="only the system on this port")


def main(options: argparse.Namespace, command: str) -> int:
    """End the systems of this checkout."""
    systems = running.systems(options.port)
    if not systems:
        say("down: no system of this checkout is running")
        return 0
    for system in systems:
        for number, grace in STAGES:
            with contextlib.suppress(ProcessLookupError):
                os.kill(system.pid, number)
            if processes.wait_until(lambda s=system: not s.alive, grace):  # type: ignore[misc]
                break
        else:
            raise CliError(
                f"process {system.pid} (port {system.port}) does not end; kill it by hand"
            )
        system.file.unlink(missing_ok=True)
        say(f"down: ended {system.command} of {system.cell} on port {system.port}")
    return 0
