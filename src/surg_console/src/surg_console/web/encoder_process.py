"""Runs the encoder, a child process that writes picture packets to its standard output.

The child (`video_node`) receives and encodes the pictures, so input and status never wait for them.
It reads commands from standard input, one per line:

    want left:h264:0 stereo:jpeg:100
    key left:h264

The number is the time between two pictures, at least [ms].
It exits when its input ends, so also when the server is killed.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Mapping, Sequence

from surg_console.web import picture_packet

RESTART = 1.0
"""[s] Pause before the encoder is restarted."""
SILENT = 1.0
"""[s] Time without pictures after which a problem is reported."""


class EncoderProcess:
    """Keeps the encoder running and forwards its pictures.

    Args:
        show: Called with every picture.
        problem: Called with why there are no pictures; empty: there are.
    """

    def __init__(
        self,
        argv: Sequence[str],
        show: Callable[[picture_packet.Packet], None],
        problem: Callable[[str], None],
    ) -> None:
        self._argv, self._show, self._problem = tuple(argv), show, problem
        self._wanted: Mapping[tuple[str, str], int] = {}
        self._child: asyncio.subprocess.Process | None = None
        self._seen = time.monotonic()

    def want(self, wanted: Mapping[tuple[str, str], int]) -> None:
        """Set the watched layouts and codecs, each with the time between two pictures [ms]."""
        self._wanted = wanted
        self._seen = time.monotonic()
        items = sorted(wanted.items())
        self._write("want", *(f"{layout}:{codec}:{spacing}" for (layout, codec), spacing in items))

    def key(self, layout: str, codec: str) -> None:
        """Request a key picture."""
        self._write("key", f"{layout}:{codec}")

    async def run(self) -> None:
        """Run the encoder, and restart it when it ends; until cancelled."""
        watch = asyncio.create_task(self._watch())
        try:
            while True:
                code = await self._once()
                self._problem(f"no pictures: the encoder exited with code {code}; restarting it")
                await asyncio.sleep(RESTART)
        finally:
            watch.cancel()

    async def _once(self) -> int:
        """Run the encoder once; returns its exit code."""
        pipe = asyncio.subprocess.PIPE
        child = await asyncio.create_subprocess_exec(
            *self._argv, stdin=pipe, stdout=pipe, limit=picture_packet.LARGEST
        )
        self._child = child
        try:
            self.want(self._wanted)
            assert child.stdout is not None
            with contextlib.suppress(asyncio.IncompleteReadError, picture_packet.PacketError):
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
        """Report a problem when no pictures arrive although somebody watches."""
        while True:
            await asyncio.sleep(0.2)
            silent = time.monotonic() - self._seen > SILENT
            if self._child is not None:
                self._problem(
                    "no pictures from the endoscope; check its node with ./surg status"
                    if silent and self._wanted
                    else ""
                )

    def _write(self, *words: str) -> None:
        child = self._child
        if child is not None and child.stdin is not None and not child.stdin.is_closing():
            child.stdin.write((" ".join(words) + "\n").encode())
