"""The sockets /control and /status: status out; inputs and buttons in, or Stop alone."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Callable, Mapping
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from surg_console.session import operator_messages
from surg_console.session.console_session import ConsoleSession
from surg_console.session.system_state import Robot
from surg_console.web.admission import ENDED
from surg_console.web.page_connection import MessageBudget, Outbox
from surg_console.web.page_protocol import (
    JUDGEMENTS,
    Hidden,
    Input,
    PageMessage,
    Ping,
    Press,
    ProtocolError,
    Scale,
    parse,
)
from surg_console.web.running_system import RunningSystem

MAX_ERRORS = 5
"""Invalid messages after which a page is disconnected."""
Handler = Callable[[PageMessage, str, Outbox, float], None]
"""Handles a message of a page, by its name, with its outbox, at a time [s]."""


class ControlPages:
    """The pages that drive or watch the session.

    Attributes:
        monitors: Number of open pages that only watch.
        ending: The console ends; only Stop is obeyed any more.
    """

    def __init__(
        self, session: ConsoleSession, system: RunningSystem, facts: Mapping[str, Any]
    ) -> None:
        self._session, self._system, self._facts = session, system, facts
        self._outboxes: dict[str, Outbox] = {}
        self._newest: dict[str, str] = {}
        self._pages_so_far = 0
        self._judging: set[asyncio.Task[None]] = set()  # a task that nobody holds may vanish
        self.monitors, self.ending = 0, False

    def update_all(self, kind: str, text: str) -> None:
        """Replace what all pages show of this kind; pages to come get it as well."""
        self._newest[kind] = text
        for outbox in self._outboxes.values():
            outbox.update(kind, text)

    def send_orders(self) -> None:
        """Publish what the session has decided."""
        orders = self._session.take_orders()
        if orders:
            self._system.publish_orders(orders)

    async def serve(self, socket: web.WebSocketResponse) -> None:
        """A page of the session, until it disconnects or breaks the protocol."""
        self._pages_so_far += 1
        page = f"page {self._pages_so_far}"
        self._session.join(page, time.monotonic())

        def leave() -> None:
            self._session.leave(page, time.monotonic())
            self.send_orders()

        await self._converse(socket, page, self._handle, leave)

    async def serve_monitor(self, socket: web.WebSocketResponse) -> None:
        """A page that watches: it is no page of the session, and Stop is all that it may ask."""
        self._pages_so_far += 1
        self.monitors += 1

        def leave() -> None:
            self.monitors -= 1

        await self._converse(socket, f"monitor {self._pages_so_far}", self._handle_monitor, leave)

    async def _converse(
        self,
        socket: web.WebSocketResponse,
        page: str,
        handle: Handler,
        leave: Callable[[], None],
    ) -> None:
        """Send the status to a page and handle its messages until it ends."""
        outbox = self._outboxes[page] = Outbox()
        outbox.reply(json.dumps({"say": "welcome", "page": page, **self._facts}))
        if "episodes" in self._newest:
            outbox.update("episodes", self._newest["episodes"])
        sender = asyncio.create_task(_send_texts(socket, outbox))
        violation = b""
        try:
            violation = await self._receive(socket, page, outbox, handle)
        finally:
            leave()
            del self._outboxes[page]
            sender.cancel()
            # Last: a page that floods may never answer, and must not keep its place until then.
            broken = {"code": WSCloseCode.POLICY_VIOLATION, "message": violation}
            await socket.close(**(broken if violation else ENDED))

    async def _receive(
        self, socket: web.WebSocketResponse, page: str, outbox: Outbox, handle: Handler
    ) -> bytes:
        """Handle a page's messages until it disconnects or breaks the protocol; returns how."""
        budget, errors = MessageBudget(time.monotonic()), 0
        async for frame in socket:
            await asyncio.sleep(0)  # messages that wait in the buffer must not hold up the others
            now = time.monotonic()
            if not budget.spend(now):
                return b"too many messages"
            try:
                if frame.type is not WSMsgType.TEXT:
                    raise ProtocolError("a message is a text")
                message = parse(frame.data)
                if isinstance(message, Ping):
                    wall_us = time.time_ns() // 1000
                    pong = {"say": "pong", "at": message.at, "wall_us": wall_us}
                    outbox.reply(json.dumps(pong))
                else:
                    handle(message, page, outbox, now)
            except ProtocolError as error:
                errors += 1
                outbox.reply(json.dumps({"say": "refused", "why": str(error)}))
                if errors >= MAX_ERRORS:
                    return b"too many invalid messages"
        return b""

    def _handle(self, message: PageMessage, page: str, outbox: Outbox, now: float) -> None:
        stops = isinstance(message, Press) and message.button == "stop"
        if self.ending and not stops:
            return
        refused = _pass_on(self._session, message, page, self._system.robot(), now)
        self.send_orders()
        if refused:
            outbox.reply(json.dumps({"say": "refused", "why": refused}))
        elif isinstance(message, Press) and message.button in JUDGEMENTS:
            task = asyncio.create_task(self._judge(message.button, outbox))
            self._judging.add(task)
            task.add_done_callback(self._judging.discard)

    async def _judge(self, word: str, outbox: Outbox) -> None:
        """Files may take their time, and the arm must be watched meanwhile."""
        loop = asyncio.get_running_loop()
        if refused := await loop.run_in_executor(None, self._system.judge, word):
            outbox.reply(json.dumps({"say": "refused", "why": refused}))

    def _handle_monitor(self, message: PageMessage, page: str, outbox: Outbox, now: float) -> None:
        if not isinstance(message, Press) or message.button != "stop":
            raise ProtocolError("a monitor watches; allowed: ping, and the button stop")
        self._session.stop(self._system.robot(), page)
        self.send_orders()


async def _send_texts(socket: web.WebSocketResponse, outbox: Outbox) -> None:
    with contextlib.suppress(ConnectionError):
        while True:
            for text in await outbox.take():
                await socket.send_str(text)


def _pass_on(
    session: ConsoleSession, message: PageMessage, page: str, robot: Robot, now: float
) -> str:
    """Hand a message to the session; returns why it is refused.

    Raises:
        ProtocolError: It belongs on another socket.
    """
    if isinstance(message, Input):
        session.receive(page, message, now)
        return ""
    if isinstance(message, Press):
        return _press(session, message, page, robot, now)
    if isinstance(message, Hidden):
        session.hide(page, message.why)
        return ""
    if isinstance(message, Scale):
        return session.scale(page, message.value)
    raise ProtocolError(f"{type(message).__name__.lower()} does not belong on this socket")


def _press(session: ConsoleSession, message: Press, page: str, robot: Robot, now: float) -> str:
    in_time = session.in_time(page, message.at, now)
    if message.button == "stop":  # obeyed however late
        session.stop(robot, page)
        return ""
    if message.button == "release":
        session.release(page)
        return ""
    if not in_time:
        return operator_messages.LATE
    if message.button == "take":
        return session.take(page, now)
    if message.button == "enable":
        return session.enable(page, robot, now)
    if message.button == "guide_home":
        return session.guide_home(page, robot)
    if message.button == "policy":
        return session.policy(page, robot, now)
    if message.button == "new_episode":
        return session.new_episode(page, robot, now)
    if message.button in JUDGEMENTS:
        return session.judge(page, robot)
    return session.record(page, robot, message.button == "record")
