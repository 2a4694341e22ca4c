"""The server's end of the encoder: a child process that writes packets on its standard output.

The child (`video_node`) receives and encodes the pictures, so that neither input nor status ever
waits for them. It is told on standard input what is wanted, one line each:

    want left:h264 stereo:jpeg
    key left:h264

It ends when its input ends, also when the server was killed.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence

from surg_teleop.console.web import picture_packet

RESTART = 1.0
"""[s] before an encoder that has ended is started again."""
SILENT = 1.0
"""[s] without a picture that are worth a word."""


class EncoderProcess:
    """Keeps an encoder running, and passes its pictures on.

    Args:
        argv: Its command line.
        show: Called with every picture.
        problem: Called with why there is none; empty: they come.
    """

    def __init__(
        self,
        argv: Sequence[str],
        show: Callable[[picture_packet.Packet], None],
        problem: Callable[[str], None],
    ) -> None:
        self._argv, self._show, self._problem = tuple(argv), show, problem
        self._wanted: frozenset[tuple[str, str]] = frozenset()
        self._child: asyncio.subprocess.Process | None = None
        self._seen = time.monotonic()

    def want(self, wanted: frozenset[tuple[str, str]]) -> None:
        """See `server.Pictures`."""
        self._wanted = wanted
        self._seen = time.monotonic()
        self._tell("want", *(f"{layout}:{codec}" for layout, codec in sorted(wanted)))

    def key(self, layout: str, codec: str) -> None:
        """See `server.Pictures`."""
        self._tell("key", f"{layout}:{codec}")

    async def run(self) -> None:
        """Start the encoder, and again when it ends; until cancelled."""
        watch = asyncio.create_task(self._watch())
        try:
            while True:
                code = await self._once()
                self._problem(f"no pictures: the encoder ended with code {code}; it is restarted")
                await asyncio.sleep(RESTART)
        finally:
            watch.cancel()

    async def _once(self) -> int:
        """One life of the encoder; returns its exit code."""
        pipe = asyncio.subprocess.PIPE
        child = await asyncio.create_subprocess_exec(
            *self._argv, stdin=pipe, stdout=pipe, limit=picture_packet.LARGEST
        )
        self._child = child
        try:
            self.want(self._wanted)
            assert child.stdout is not None
            with contextlib.suppress(asyncio.IncompleteReadError, picture_packet.WireError):
                while True:
                    header = await child.stdout.readexactly(picture_packet.HEADER_BYTES)
                    data = await child.stdout.readexactly(picture_packet.size_of(header))
                    self._seen = time.monotonic()
                    self._show(picture_packet.unpack(header + data))
        finally:
            self._child = None
            with contextlib.suppress(ProcessLookupError):
                child.kill()
            await child.wait()
        assert child.returncode is not None
        return child.returncode

    async def _watch(self) -> None:
        """Say so when no picture comes although somebody watches."""
        while True:
            await asyncio.sleep(0.2)
            silent = time.monotonic() - self._seen > SILENT
            if self._child is not None:
                self._problem(
                    "no pictures come from the endoscope (./surg status shows its node)"
                    if silent and self._wanted
                    else ""
                )

    def _tell(self, *words: str) -> None:
        child = self._child
        if child is not None and child.stdin is not None and not child.stdin.is_closing():
            child.stdin.write((" ".join(words) + "\n").encode())
