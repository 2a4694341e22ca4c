"""The socket of the page /calibrate: the collector's status out, four requests in.

It is no socket of the session: no message on it can take control of an arm or move one.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from typing import Any

from aiohttp import WSMsgType, web

from surg_console.session.console_orders import Calibrate
from surg_console.web.admission import ENDED
from surg_console.web.page_connection import MessageBudget
from surg_console.web.page_protocol import CalibrationPress, ProtocolError, parse
from surg_console.web.running_system import RunningSystem

PERIOD = 0.1
"""[s] Of the status."""
NOT_RUNNING = "No collector runs. Type: ./surg calibrate {} live"
"""With the name of the cell."""


def refusal(now: dict[str, Any] | None, cell: str = "CELL") -> str:
    """Why a request is not passed on; empty: it is."""
    if now is None:
        return NOT_RUNNING.format(cell)
    if now["state"] == "SOLVING":
        return "The step is being solved. Wait for its result."
    return ""


class CalibrationPages:
    """The open pages.

    Args:
        system: The running system.
        facts: The name of the cell and the eyes that are shown.
    """

    def __init__(self, system: RunningSystem, facts: dict[str, Any]) -> None:
        self._system, self._facts = system, facts
        self.open = 0

    async def serve(self, socket: web.WebSocketResponse) -> None:
        """Serve one page until it disconnects or breaks the protocol."""
        self.open += 1
        sender = asyncio.create_task(self._send(socket))
        try:
            with contextlib.suppress(ProtocolError):
                await self._receive(socket)
        finally:
            self.open -= 1
            sender.cancel()
            await socket.close(**ENDED)

    async def _receive(self, socket: web.WebSocketResponse) -> None:
        budget = MessageBudget(time.monotonic())
        async for frame in socket:
            await asyncio.sleep(0)
            message = parse(frame.data) if frame.type is WSMsgType.TEXT else None
            if not budget.spend(time.monotonic()) or not isinstance(message, CalibrationPress):
                return
            why = refusal(self._system.robot().calibration, self._facts["cell"])
            if why:
                await socket.send_str(json.dumps({"say": "refused", "why": why}))
            else:
                self._system.publish_orders([Calibrate(message.request)])

    async def _send(self, socket: web.WebSocketResponse) -> None:
        sent = ""
        with contextlib.suppress(ConnectionError):
            await socket.send_str(json.dumps({"say": "welcome", **self._facts}))
            while True:
                text = json.dumps(
                    report(self._system.robot().calibration, self._facts["cell"]), allow_nan=False
                )
                if text != sent:
                    await socket.send_str(text)
                    sent = text
                await asyncio.sleep(PERIOD)


def report(now: dict[str, Any] | None, cell: str) -> dict[str, Any]:
    """The status of a page; without a collector: how to start one."""
    if now is None:
        return {"say": "calibration", "running": False, "hint": NOT_RUNNING.format(cell)}
    return {"say": "calibration", "running": True, **now}
