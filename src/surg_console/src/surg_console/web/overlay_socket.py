"""What a page may show beside or over the picture: the sockets /marks, /plan, /scene and /feel.

They are no sockets of the session: values go out while a page shows them, and nothing comes in.
Nobody computes them while none is open.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter

from aiohttp import web

from surg_console.web.running_system import RunningSystem

PERIODS = {"marks": 0.01, "plan": 0.05, "scene": 0.1, "feel": 0.02}
"""[s] at which news are looked for."""


class OverlayPages:
    """The open sockets."""

    def __init__(self, source: RunningSystem) -> None:
        self._source = source
        self._open: Counter[str] = Counter()

    def open(self, what: str) -> int:
        """Number of open sockets of a kind."""
        return self._open[what]

    async def serve(self, what: str, socket: web.WebSocketResponse) -> None:
        """Serve one page until it disconnects or says anything."""
        self._open[what] += 1
        if self._open[what] == 1:
            self._source.watch(what, True)
        sender = asyncio.create_task(self._send(socket, what))
        try:
            await socket.receive()  # its end, or a word too much
        finally:
            sender.cancel()
            self._open[what] -= 1
            if self._open[what] == 0:
                self._source.watch(what, False)
            await socket.close()

    async def _send(self, socket: web.WebSocketResponse, what: str) -> None:
        sent = ""
        with contextlib.suppress(ConnectionError):
            while True:
                text = self._source.overlay(what)
                if text and text != sent:
                    await socket.send_str(text)
                    sent = text
                await asyncio.sleep(PERIODS[what])
