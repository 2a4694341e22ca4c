"""PyPI's franky-sim, somebody else's simulator of an FR3, as a process."""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from helpers.hardware.emulated_ur import free_address
from surg_cli.graph.processes import wait_until
from surg_cli.host import paths

FRANKY_SIM = "franky-sim==1.0.4"
PRIORITY = 60
"""As of our emulators: beside other work it would fall behind real time."""


@contextmanager
def running(python: Path, log: Path, q: Sequence[float]) -> Iterator[str]:
    """The simulator with its arm at these joints [rad]; yields its address."""
    address = free_address()
    program = paths.ROOT / "tests" / "helpers" / "hardware" / "franky_sim_server.py"
    words = [str(python), str(program), address, *(str(float(angle)) for angle in q)]
    with log.open("w") as output:
        process = subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT, env={})
        with contextlib.suppress(OSError):
            os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(PRIORITY))
        try:
            assert wait_until(lambda: "ready" in log.read_text(), 60.0), log.read_text()
            yield address
        finally:
            process.terminate()
            process.wait(10.0)
