"""The console's web server: page, control socket and picture socket. No ROS.

``/`` and ``/page/…`` serve the page, ``/control`` its input and status, ``/pictures`` the
endoscope's pictures. ``/marks``, ``/plan`` and ``/scene`` are what is shown over and beside them,
``/feel`` is what is heard and rumbles. ``/calibrate`` is the page that collects calibration views,
``/calibration`` its socket. ``/monitor`` shows the pictures on a 3D monitor, ``/status`` is its
socket: status out, Stop in. The pages are public; all sockets demand the token in a first
`hello`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from aiohttp import WSCloseCode, WSMsgType, web

from surg_console.session.console_orders import Follow, Order, Present
from surg_console.session.console_session import Session
from surg_console.session.episode_list import Entry
from surg_console.session.page_status import report
from surg_console.session.system_state import Robot
from surg_console.web import http_policy
from surg_console.web.access import Access
from surg_console.web.beside_socket import PERIODS, BesidePages
from surg_console.web.calibration_socket import CalibrationPages
from surg_console.web.encoder_process import EncoderProcess
from surg_console.web.listener import Connection, Listener, listen
from surg_console.web.page_connection import MessageBudget, Outbox, Viewer
from surg_console.web.page_dispatch import dispatch
from surg_console.web.page_protocol import (
    LONGEST,
    Hello,
    PageMessage,
    Ping,
    Press,
    ProtocolError,
    Shown,
    Watch,
    parse,
)
from surg_console.web.picture_packet import Packet
from surg_console.web.picture_queue import PictureQueue

TICK = 0.01
"""[s] Period of the session."""
STATUS = 0.05
"""[s] Period of the status reports."""
LIST = 1.0
"""[s] Period of the list of episodes."""
ROOM_WAIT = 1.0
"""[s] Longest wait of a new page for room: pages that flood leave within this time."""
HELLO_WAIT = 3.0
"""[s] Timeout of a page's `hello`."""
GOODBYE_WAIT = 1.0
"""[s] Timeout for closing all sockets; one on a dead link would take minutes."""
MAX_PAGES = 8
MAX_ERRORS = 5
"""Invalid messages after which a page is disconnected."""

PAGES = {
    "/": "index.html",
    "/calibrate": "calibrate.html",
    "/monitor": "monitor.html",
    "/headset": "headset.html",
}
SOCKETS = ("/control", "/status", "/pictures", "/calibration", *(f"/{what}" for what in PERIODS))
Handler = Callable[[PageMessage, str, "Outbox", float], None]
"""Handles a message of a page, by its name, with its outbox, at a time [s]."""
CLOSE_HELLO, CLOSE_FULL = 4401, 4429
"""WebSocket close codes: wrong or missing token; too many pages."""


class System(Protocol):
    """The running system, as the server sees it."""

    def robot(self) -> Robot:
        """Its present state."""

    def told(self) -> None:
        """The pages have got the state; peak values start again."""

    def obey(self, orders: list[Order]) -> None:
        """Send orders; must not block."""

    def live(self) -> None:
        """Called all the time: re-publishes what is held down, so that silence is noticed."""

    def entries(self) -> list[Entry]:
        """The recorded episodes; may read files."""

    def watch(self, what: str, wanted: bool) -> None:
        """See `beside_socket.Source`."""

    def beside(self, what: str) -> str:
        """See `beside_socket.Source`."""


class Server:
    """One console.

    Args:
        facts: Sent to the page once: cell, arm, views, ….
        limits: Of the driven arm [SI].
    """

    def __init__(
        self,
        access: Access,
        session: Session,
        system: System,
        pictures: EncoderProcess,
        facts: Mapping[str, Any],
        limits: Mapping[str, float],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.session = session
        self._access, self._system, self._pictures = access, system, pictures
        self._facts, self._limits, self._clock = facts, limits, clock
        self._files = http_policy.page_files()
        self._outboxes: dict[str, Outbox] = {}
        self._viewers: set[Viewer] = set()
        self._calibrators = CalibrationPages(system, {"cell": facts["cell"]}, clock)
        self._beside = BesidePages(system)
        self._sockets: set[web.WebSocketResponse] = set()
        # By path of the socket: turns of new pages, the longest wait first.
        self._waiting: defaultdict[str, list[object]] = defaultdict(list)
        self._pages_so_far, self._monitors, self._ending = 0, 0, False
        self._episodes = ""
        self._picture_problem = ""

    def application(self) -> web.Application:
        """The aiohttp application."""
        app = web.Application(middlewares=[self._in_turn, self._guard], client_max_size=LONGEST)
        for path in (*PAGES, "/page/{name:.+}"):
            app.router.add_get(path, self._page)
        for what in PERIODS:
            app.router.add_get(f"/{what}", self._show_beside)
        app.router.add_get("/calibration", self._calibration)
        app.router.add_get("/control", self._control)
        app.router.add_get("/status", self._status)
        app.router.add_get("/pictures", self._stream)
        app.on_response_prepare.append(http_policy.add_headers)
        return app

    async def serve(self, stop: asyncio.Event) -> None:
        """Serve until `stop` is set or a task fails; either way the arm holds afterwards.

        Raises:
            OSError: The address or port is not available.
        """
        runner = web.AppRunner(self.application(), access_log=None, handle_signals=False)
        await runner.setup()
        loops = (self._session_loop, self._status_loop, self._episodes_loop)
        tasks = [asyncio.create_task(loop()) for loop in loops]
        listening: asyncio.Task[None] | None = None
        try:
            assert runner.server is not None
            listener = Listener(runner.server, http_policy.tls_context(self._access))
            sockets = listen(self._access.bind, self._access.port)
            listening = asyncio.create_task(listener.serve(sockets))
            stopped = asyncio.create_task(stop.wait())
            ends = [stopped, listening, *tasks]
            done, _ = await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()  # raises what a failed task has raised
        finally:
            self._ending = True
            self._system.obey([Present(False), Follow(False)])
            for task in tasks:
                task.cancel()
            await self._close_sockets()
            if listening is not None:
                listening.cancel()
                await asyncio.wait([listening])
            if runner.server is not None:
                await runner.server.shutdown(GOODBYE_WAIT)
            await runner.cleanup()

    async def _close_sockets(self) -> None:
        """Close all sockets at once: one on a dead link must not delay the others."""
        code, text = WSCloseCode.GOING_AWAY, b"The console has ended. Reconnecting every second."
        closing = [socket.close(code=code, message=text) for socket in self._sockets]
        with contextlib.suppress(TimeoutError):
            everyone = asyncio.gather(*closing, return_exceptions=True)
            await asyncio.wait_for(everyone, GOODBYE_WAIT)

    def show(self, packet: Packet) -> None:
        """Send a new picture to everybody who watches its layout and codec."""
        for viewer in self._viewers:
            if viewer.stream == (packet.layout, packet.codec):
                viewer.queue.put(packet)
                viewer.changed.set()

    def picture_problem(self, text: str) -> None:
        """Set why there are no pictures; empty: there are."""
        self._picture_problem = text

    # --- periodic tasks -----------------------------------------------------------------------

    async def _session_loop(self) -> None:
        while True:
            self.session.tick(self._system.robot(), self._clock())
            self._send_orders()
            self._system.live()
            for viewer in self._viewers:
                if viewer.stream and viewer.queue.wants_key(self._clock()):
                    self._pictures.key(*viewer.stream)
            await asyncio.sleep(TICK)

    async def _status_loop(self) -> None:
        while True:
            status = report(self.session, self._system.robot(), self._limits, self._clock())
            status["picture_problem"] = self._picture_problem
            self._system.told()
            self._update_all("status", json.dumps(status, allow_nan=False))
            await asyncio.sleep(STATUS)

    async def _episodes_loop(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            entries = await loop.run_in_executor(None, self._system.entries)
            text = json.dumps({"say": "episodes", "episodes": [vars(entry) for entry in entries]})
            if text != self._episodes:
                self._episodes = text
                self._update_all("episodes", text)
            await asyncio.sleep(LIST)

    def _update_all(self, kind: str, text: str) -> None:
        for outbox in self._outboxes.values():
            outbox.update(kind, text)

    def _send_orders(self) -> None:
        orders = self.session.take_orders()
        if orders:
            self._system.obey(orders)

    # --- requests -----------------------------------------------------------------------------

    @web.middleware
    async def _guard(self, request: web.Request, handler: Any) -> web.StreamResponse:
        """Reject unknown host names, and sockets from foreign pages."""
        if not self._access.host_allowed(request.headers.get("Host")):
            text = "421: unknown host name; open the address that the console has printed"
            return web.Response(status=421, text=text + "\n")
        if request.path in SOCKETS and not self._access.origin_allowed(
            request.headers.get("Origin")
        ):
            return web.Response(status=403, text="403: only the console's own page may connect\n")
        response: web.StreamResponse = await handler(request)
        return response

    @web.middleware
    async def _in_turn(self, request: web.Request, handler: Any) -> web.StreamResponse:
        """Answer requests at a bounded rate: a flood must not hold up inputs and status."""
        connection = request.protocol
        assert isinstance(connection, Connection)
        await connection.begin()
        try:
            response: web.StreamResponse = await handler(request)
            return response
        finally:
            connection.end()

    async def _page(self, request: web.Request) -> web.StreamResponse:
        name = PAGES.get(request.path) or request.match_info["name"]
        content = self._files.get(name)
        if content is None:
            return web.Response(status=404, text="404: no such file\n")
        content_type = http_policy.TYPES[name.rpartition(".")[2]]
        return web.Response(body=content, content_type=content_type, charset="utf-8")

    async def _admit(
        self, request: web.Request, open_pages: Callable[[], int]
    ) -> web.WebSocketResponse | None:
        """Open a socket and check its `hello`; None: it was closed again."""
        socket = web.WebSocketResponse(
            max_msg_size=4 * LONGEST, heartbeat=10.0, compress=False, timeout=GOODBYE_WAIT
        )
        await socket.prepare(request)
        try:
            hello = parse(await asyncio.wait_for(socket.receive_str(), HELLO_WAIT))
        except (TimeoutError, TypeError, ProtocolError):
            hello = None
        if not isinstance(hello, Hello) or not self._access.token_allowed(hello.token):
            await asyncio.sleep(0.5)  # slows down guessing
            await socket.close(code=CLOSE_HELLO, message=b"open the whole address, with its token")
            return None
        if not await self._room(request.path, open_pages):
            await socket.close(code=CLOSE_FULL, message=b"too many pages are open")
            return None
        self._sockets.add(socket)
        connection = request.protocol
        assert isinstance(connection, Connection)
        connection.become_page()
        return socket

    async def _room(self, path: str, open_pages: Callable[[], int]) -> bool:
        """Wait for room, in the order of arrival: who left must not come back before others."""
        turn, waiting = object(), self._waiting[path]
        waiting.append(turn)
        deadline = self._clock() + ROOM_WAIT
        try:
            while waiting[0] is not turn or open_pages() >= MAX_PAGES:
                if self._clock() >= deadline:
                    return False
                await asyncio.sleep(TICK)
            return True
        finally:
            waiting.remove(turn)

    # --- input and status ---------------------------------------------------------------------

    async def _control(self, request: web.Request) -> web.StreamResponse:
        socket = await self._admit(request, lambda: self.session.pages)
        if socket is None:
            return web.Response()
        self._pages_so_far += 1
        page = f"page {self._pages_so_far}"
        self.session.join(page, self._clock())

        def leave() -> None:
            self.session.leave(page, self._clock())
            self._send_orders()

        await self._converse(socket, page, self._handle, leave)
        return socket

    async def _status(self, request: web.Request) -> web.StreamResponse:
        """A page that watches: it is no page of the session, and Stop is all that it may ask."""
        socket = await self._admit(request, lambda: self._monitors)
        if socket is None:
            return web.Response()
        self._pages_so_far += 1
        self._monitors += 1

        def leave() -> None:
            self._monitors -= 1

        await self._converse(socket, f"monitor {self._pages_so_far}", self._handle_monitor, leave)
        return socket

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
        if self._episodes:
            outbox.update("episodes", self._episodes)
        sender = asyncio.create_task(_send_texts(socket, outbox))
        violation = b""
        try:
            violation = await self._receive(socket, page, outbox, handle)
        finally:
            leave()
            del self._outboxes[page]
            self._sockets.discard(socket)
            sender.cancel()
            # Last: a page that floods may never answer, and must not keep its place until then.
            await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=violation)

    async def _receive(
        self, socket: web.WebSocketResponse, page: str, outbox: Outbox, handle: Handler
    ) -> bytes:
        """Handle a page's messages until it disconnects or breaks the protocol; returns how."""
        budget, errors = MessageBudget(self._clock()), 0
        async for frame in socket:
            await asyncio.sleep(0)  # messages that wait in the buffer must not hold up the others
            now = self._clock()
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
        if self._ending and not stops:
            return
        refused = dispatch(self.session, message, page, self._system.robot(), now)
        self._send_orders()
        if refused:
            outbox.reply(json.dumps({"say": "refused", "why": refused}))

    def _handle_monitor(self, message: PageMessage, page: str, outbox: Outbox, now: float) -> None:
        if not isinstance(message, Press) or message.button != "stop":
            raise ProtocolError("a monitor watches; allowed: ping, and the button stop")
        self.session.stop(self._system.robot(), page)
        self._send_orders()

    async def _calibration(self, request: web.Request) -> web.StreamResponse:
        socket = await self._admit(request, lambda: self._calibrators.open)
        if socket is None:
            return web.Response()
        try:
            await self._calibrators.serve(socket)
        finally:
            self._sockets.discard(socket)
        return socket

    async def _show_beside(self, request: web.Request) -> web.StreamResponse:
        what = request.path[1:]
        socket = await self._admit(request, lambda: self._beside.open(what))
        if socket is None:
            return web.Response()
        try:
            await self._beside.serve(socket, what)
        finally:
            self._sockets.discard(socket)
        return socket

    # --- pictures -----------------------------------------------------------------------------

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        socket = await self._admit(request, lambda: len(self._viewers))
        if socket is None:
            return web.Response()
        viewer = Viewer()
        self._viewers.add(viewer)
        sender = asyncio.create_task(self._send_pictures(socket, viewer))
        try:
            with contextlib.suppress(ProtocolError):
                await self._receive_viewer(socket, viewer)
        finally:
            self._viewers.discard(viewer)
            self._sockets.discard(socket)
            self._want_streams()
            sender.cancel()
            await socket.close()
        return socket

    async def _receive_viewer(self, socket: web.WebSocketResponse, viewer: Viewer) -> None:
        """Handle a viewer's messages until it disconnects or breaks the protocol."""
        budget = MessageBudget(self._clock())
        async for frame in socket:
            await asyncio.sleep(0)
            message = parse(frame.data) if frame.type is WSMsgType.TEXT else None
            if not budget.spend(self._clock()):
                return
            if isinstance(message, Watch):
                viewer.stream, viewer.queue = (message.layout, message.codec), PictureQueue()
                self._want_streams()
            elif isinstance(message, Shown):
                viewer.queue.drawn(message.seq)
                viewer.changed.set()
            else:
                return

    def _want_streams(self) -> None:
        wanted = {viewer.stream for viewer in self._viewers if viewer.stream is not None}
        self._pictures.want(frozenset(wanted))

    async def _send_pictures(self, socket: web.WebSocketResponse, viewer: Viewer) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                await viewer.changed.wait()
                viewer.changed.clear()
                packet = viewer.queue.take(self._clock())
                if packet is not None:
                    await socket.send_bytes(packet.pack())


async def _send_texts(socket: web.WebSocketResponse, outbox: Outbox) -> None:
    with contextlib.suppress(ConnectionError):
        while True:
            for text in await outbox.take():
                await socket.send_str(text)
