"""A running `./surg teleop` for tests with a browser: address of its page, places of the tips."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import numpy as np

from helpers.graph.surg import environment, start
from helpers.teleop.console_page import when
from surg_cli.graph import master
from surg_cli.host import paths

STILL = 0.0001
"""[m] that a tip may still go while it comes to rest."""


class Phantom:
    """A running `./surg teleop`.

    Attributes:
        url: Of the page.
        out: Folder of the episodes.
        tips: Steady clock [s] and the instrument's tip in its rcm frame [m], as it came.
        q: Its orientation x, y, z, w there.
        lens: The same of the endoscope's, where an arm holds it.
        task: States of the task as `tip_printer` says them, where it plays one.
    """

    def __init__(self, url: str, out: Path) -> None:
        self.url, self.out = url, out
        self.tips: list[tuple[float, np.ndarray]] = []
        self.q = np.array([0.0, 0.0, 0.0, 1.0])
        self.lens: list[tuple[float, np.ndarray]] = []
        self.task: list[dict[str, Any]] = []
        self.heard: dict[str, tuple[list[Any], Callable[[bytes], Any]]] = {
            "PSM1": (self.tips, self._tip),
            "ECM": (self.lens, lambda line: _pose(line)[:2]),
            "task": (self.task, json.loads),
        }

    def _tip(self, line: bytes) -> tuple[float, np.ndarray]:
        at, p, self.q = _pose(line)
        return at, p

    @property
    def tip(self) -> np.ndarray:
        """Where the tip is now."""
        return self.tips[-1][1]

    def rest_since(self) -> float:
        """When the tip came to where it is now [s]."""
        end = self.tip
        for at, tip in reversed(self.tips):
            if np.linalg.norm(tip - end) > STILL:
                return at
        return self.tips[0][0]


@contextlib.asynccontextmanager
async def phantom(
    folder: Path, cell: str, *more: object, of: tuple[str, ...] = ("PSM1", "ECM", "task")
) -> AsyncIterator[Phantom]:
    """`./surg teleop CELL` with further words, until the end of the context.

    Of an arm or task that is not in `of` nothing is known: each that is takes 0.04 of a core.
    """
    port, web = master.free_port(), master.free_port()
    log, out = folder / "teleop.log", folder / "out"
    words = ("teleop", cell, "--port", port, "--bind", f"127.0.0.1:{web}", "--out", out, *more)
    with start(log, *words) as process:
        printers: list[tuple[asyncio.subprocess.Process, asyncio.Task[None]]] = []
        try:
            await when(lambda: "Open http" in log.read_text(), "the system", 120.0)
            made = Phantom(f"http://localhost:{web}/", out)
            there = of if "two_arms" in cell else ("PSM1",)
            for name in there:
                printers.append(await _printed(name, port, *made.heard[name]))
            yield made
            assert process.poll() is None, log.read_text()
        finally:
            for printer, reading in printers:
                reading.cancel()
                with contextlib.suppress(ProcessLookupError):
                    printer.kill()
                await printer.wait()
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(60)


async def _printed(
    of: str, port: int, into: list[Any], read: Callable[[bytes], Any]
) -> tuple[asyncio.subprocess.Process, asyncio.Task[None]]:
    """A process that says what a test needs to know, and the task that reads its lines."""
    printer = await asyncio.create_subprocess_exec(
        sys.executable,
        str(paths.ROOT / "tests" / "helpers" / "graph" / "tip_printer.py"),
        of,
        env={**environment(), "ROS_MASTER_URI": f"http://localhost:{port}"},
        stdout=asyncio.subprocess.PIPE,
    )
    assert printer.stdout is not None
    return printer, asyncio.create_task(_read(printer.stdout, into, read))


async def _read(lines: asyncio.StreamReader, into: list[Any], read: Callable[[bytes], Any]) -> None:
    async for line in lines:
        into.append(read(line))


def _pose(line: bytes) -> tuple[float, np.ndarray, np.ndarray]:
    at, *pose = map(float, line.split())
    return at, np.array(pose[:3]), np.array(pose[3:])
