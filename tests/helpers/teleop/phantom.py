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
        web, port: Of the page, and of the ROS master.
        url: Of the page.
        out: Folder of the episodes.
        tips: Steady clock [s] and the instrument's tip in its rcm frame [m], as it came.
        q: Its orientation x, y, z, w there.
        lens: The same of the endoscope's, where an arm holds it.
        task: States of the task as `tip_printer` says them, where it plays one.
    """

    def __init__(self, web: int, port: int, out: Path) -> None:
        self.web, self.port, self.out = web, port, out
        self.url = f"http://localhost:{web}/"
        self.tips: list[tuple[float, np.ndarray]] = []
        self.q = np.array([0.0, 0.0, 0.0, 1.0])
        self.lens: list[tuple[float, np.ndarray]] = []
        self.task: list[dict[str, Any]] = []
        self.hear: dict[str, Callable[[bytes], None]] = {
            "PSM1": self._tip,
            "ECM": lambda line: self.lens.append(_pose(line)[:2]),
            "task": lambda line: self.task.append(json.loads(line)),
        }

    def _tip(self, line: bytes) -> None:
        at, p, self.q = _pose(line)
        self.tips.append((at, p))

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
        try:
            await when(lambda: "Open http" in log.read_text(), "the system", 120.0)
            made = Phantom(web, port, out)
            async with contextlib.AsyncExitStack() as stack:
                for name in of if "two_arms" in cell else of[:1]:
                    program = printed("tip_printer.py", name, port, made.hear[name])
                    await stack.enter_async_context(program)
                yield made
            assert process.poll() is None, log.read_text()
        finally:
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(90)


@contextlib.asynccontextmanager
async def printed(
    program: str, of: str, port: int, hear: Callable[[bytes], None]
) -> AsyncIterator[None]:
    """A program of `helpers.graph` that prints lines of what a test needs to know, and its hearer.

    It is a process of its own, because a test's own node belongs to another ROS master.
    """
    printer = await asyncio.create_subprocess_exec(
        sys.executable,
        str(paths.ROOT / "tests" / "helpers" / "graph" / program),
        of,
        env={**environment(), "ROS_MASTER_URI": f"http://localhost:{port}"},
        stdout=asyncio.subprocess.PIPE,
    )
    assert printer.stdout is not None
    reading = asyncio.create_task(_read(printer.stdout, hear))
    try:
        yield
    finally:
        reading.cancel()
        with contextlib.suppress(ProcessLookupError):
            printer.kill()
        await printer.wait()


async def _read(lines: asyncio.StreamReader, hear: Callable[[bytes], None]) -> None:
    async for line in lines:
        hear(line)


def _pose(line: bytes) -> tuple[float, np.ndarray, np.ndarray]:
    at, *pose = map(float, line.split())
    return at, np.array(pose[:3]), np.array(pose[3:])
