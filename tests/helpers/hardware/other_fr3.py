"""PyPI's franky-sim, somebody else's simulator of an FR3, as a process: in real time or stepped."""

from __future__ import annotations

import contextlib
import os
import struct
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from helpers.hardware.emulated_ur import free_address
from surg_cli.graph.processes import wait_until
from surg_cli.host import paths
from surg_emulators.franka.generator_motion import GeneratorMotion

FRANKY_SIM = "franky-sim==1.0.4"
PROGRAMS = paths.ROOT / "tests" / "helpers" / "hardware"
PRIORITY = 60
"""As of our emulators: beside other work it would fall behind real time."""


@contextmanager
def running(python: Path, log: Path, q: Sequence[float]) -> Iterator[str]:
    """The simulator with its arm at these joints [rad]; yields its address."""
    address = free_address()
    program = PROGRAMS / "franky_sim_server.py"
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


@contextmanager
def joints(python: Path, q: Sequence[float]) -> Iterator[Callable[[GeneratorMotion], None]]:
    """The simulator's joints in place of the emulator's, on the emulator's clock.

    Yields what replaces `GeneratorMotion.settle`: one step of the simulator.
    """
    words = [str(python), str(PROGRAMS / "franky_sim_steps.py"), *(str(float(each)) for each in q)]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={})
    asked, said = process.stdin, process.stdout
    assert asked is not None and said is not None
    moved = False

    def settle(motion: GeneratorMotion) -> None:
        nonlocal moved
        moves, moved = moved or any(motion.dq_d), any(motion.dq_d)
        asked.write(struct.pack("<8d", moves, *motion.dq_d))
        asked.flush()
        values = struct.unpack("<14d", said.read(112))
        motion.q, motion.dq = list(values[:7]), list(values[7:])

    try:
        yield settle
    finally:
        asked.close()
        process.wait(10.0)
