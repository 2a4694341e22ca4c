"""The console's web server: pages, sockets and pictures. No ROS, and no decision about motion.

``/`` and ``/page/…`` are the page; ``/control`` is the socket of input and status, ``/pictures``
that of the endoscope's pictures. Everything that is worth protecting goes through the two sockets,
and each of them begins with the page's `hello`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import ssl
import time
from collections import deque
from collections.abc import Callable, Mapping
from importlib import resources
from typing import Any, Protocol

from aiohttp import WSCloseCode, WSMsgType, web

from surg_teleop.console.session import operator_messages
from surg_teleop.console.session.console_orders import Follow, Order, Present
from surg_teleop.console.session.console_session import Session
from surg_teleop.console.session.episode_list import Entry
from surg_teleop.console.session.page_status import report
from surg_teleop.console.session.system_state import Robot
from surg_teleop.console.web.access import Access
from surg_teleop.console.web.page_protocol import (
    LONGEST,
    Hello,
    Hidden,
    Input,
    Ping,
    Press,
    ProtocolError,
    Said,
    Scale,
    Shown,
    Watch,
    parse,
)
from surg_teleop.console.web.picture_packet import Packet
from surg_teleop.console.web.picture_queue import Lane

TICK = 0.01
"""[s] between two looks of the session at everything."""
STATUS = 0.05
"""[s] between two reports to the pages."""
LIST = 1.0
"""[s] between two looks at the recorded episodes."""
HELLO_WAIT = 3.0
"""[s] for a page's first words."""
GOODBYE_WAIT = 1.0
"""[s] for taking leave of all pages; one on a dead link keeps its socket for minutes."""
MOST_PAGES = 8
MESSAGE_RATE, MESSAGE_BURST = 200.0, 600.0
"""[1/s] messages that a page may send in the long run, and at once after a pause."""
MOST_MISTAKES = 5
"""Messages that make no sense, until a page is cut off."""

CLOSE_HELLO, CLOSE_FULL = 4401, 4429
"""Codes of a closed socket: no or a wrong token; too many pages."""

TYPES = {
    "html": "text/html",
    "css": "text/css",
    "js": "text/javascript",
    "svg": "image/svg+xml",
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self'; connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), gamepad=(self)",
    "Cache-Control": "no-store",
}


class System(Protocol):
    """The running system, as the server sees it."""

    def robot(self) -> Robot:
        """What is known of it now."""

    def told(self) -> None:
        """The pages have been told what `robot` said: peaks start anew."""

    def obey(self, orders: list[Order]) -> None:
        """Send orders out; must not block."""

    def live(self) -> None:
        """Called all the time: what is held down is said again, so that an end is noticed."""

    def entries(self) -> list[Entry]:
        """The recorded episodes; may read files."""


class Pictures(Protocol):
    """Where encoded pictures come from; they arrive by `Server.show`."""

    def want(self, wanted: frozenset[tuple[str, str]]) -> None:
        """Which layouts and codecs somebody watches."""

    def key(self, layout: str, codec: str) -> None:
        """Ask for a key picture."""


class Allowance:
    """How many messages a page may still send: a bucket that fills steadily."""

    def __init__(self, now: float) -> None:
        self._left, self._seen = MESSAGE_BURST, now

    def spend(self, now: float) -> bool:
        """Take one; False: there is none left."""
        self._left = min(MESSAGE_BURST, self._left + (now - self._seen) * MESSAGE_RATE)
        self._seen = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class _Outbox:
    """What waits to be sent to one page: answers in order, of the status only the newest."""

    def __init__(self) -> None:
        self._answers: deque[str] = deque(maxlen=32)
        self._status: dict[str, str] = {}
        self._news = asyncio.Event()

    def answer(self, text: str) -> None:
        self._answers.append(text)
        self._news.set()

    def renew(self, kind: str, text: str) -> None:
        self._status[kind] = text
        self._news.set()

    async def next(self) -> list[str]:
        """Everything that waits, as soon as there is something."""
        await self._news.wait()
        self._news.clear()
        texts = [*self._answers, *self._status.values()]
        self._answers.clear()
        self._status.clear()
        return texts


class _Viewer:
    """One socket of pictures."""

    def __init__(self) -> None:
        self.lane = Lane()
        self.watched: tuple[str, str] | None = None
        self.news = asyncio.Event()


class Server:
    """One console.

    Args:
        access: Who may connect.
        session: Who drives.
        system: The robot's side.
        pictures: Where pictures come from.
        facts: For the page's heading, sent once: cell, arm, views, ….
        limits: Of the driven arm [SI].
        clock: Steady clock [s].
    """

    def __init__(
        self,
        access: Access,
        session: Session,
        system: System,
        pictures: Pictures,
        facts: Mapping[str, Any],
        limits: Mapping[str, float],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.session = session
        self._access, self._system, self._pictures = access, system, pictures
        self._facts, self._limits, self._clock = facts, limits, clock
        self._files = _page_files()
        self._outboxes: dict[str, _Outbox] = {}
        self._viewers: set[_Viewer] = set()
        self._sockets: set[web.WebSocketResponse] = set()
        self._joined, self._ending = 0, False
        self._episodes = ""
        self._picture_problem = ""

    def application(self) -> web.Application:
        """The aiohttp application."""
        app = web.Application(middlewares=[self._guard], client_max_size=LONGEST)
        app.router.add_get("/", self._page)
        app.router.add_get("/page/{name}", self._page)
        app.router.add_get("/control", self._control)
        app.router.add_get("/pictures", self._stream)
        app.on_response_prepare.append(_add_headers)
        return app

    async def serve(self, stop: asyncio.Event) -> None:
        """Listen until `stop` is set, or something breaks; either way the arm holds afterwards.

        Raises:
            OSError: The address or the port cannot be had.
        """
        runner = web.AppRunner(self.application(), access_log=None, handle_signals=False)
        await runner.setup()
        chores = [asyncio.create_task(chore()) for chore in (self._watch, self._tell, self._list)]
        try:
            site = web.TCPSite(
                runner,
                self._access.bind,
                self._access.port,
                shutdown_timeout=GOODBYE_WAIT,
                ssl_context=_tls(self._access),
            )
            await site.start()
            waiting = asyncio.create_task(stop.wait())
            done, _ = await asyncio.wait([waiting, *chores], return_when=asyncio.FIRST_COMPLETED)
            for chore in done:
                chore.result()  # a chore that broke breaks the server
        finally:
            self._ending = True
            self._system.obey([Present(False), Follow(False)])
            for chore in chores:
                chore.cancel()
            await self._say_goodbye()
            await runner.cleanup()

    async def _say_goodbye(self) -> None:
        """Close all sockets at once: a page on a dead link keeps no other one waiting."""
        code, why = WSCloseCode.GOING_AWAY, b"the console has ended"
        closing = [socket.close(code=code, message=why) for socket in self._sockets]
        with contextlib.suppress(TimeoutError):
            everyone = asyncio.gather(*closing, return_exceptions=True)
            await asyncio.wait_for(everyone, GOODBYE_WAIT)

    def show(self, packet: Packet) -> None:
        """A new picture for those who watch this layout and codec."""
        for viewer in self._viewers:
            if viewer.watched == (packet.layout, packet.codec):
                viewer.lane.put(packet)
                viewer.news.set()

    def picture_problem(self, text: str) -> None:
        """Why there are no pictures; empty: there are."""
        self._picture_problem = text

    # --- what runs by itself ------------------------------------------------------------------

    async def _watch(self) -> None:
        """The session looks at everything, a hundred times a second."""
        while True:
            self.session.tick(self._system.robot(), self._clock())
            self._flush()
            self._system.live()
            for viewer in self._viewers:
                if viewer.watched and viewer.lane.wants_key(self._clock()):
                    self._pictures.key(*viewer.watched)
            await asyncio.sleep(TICK)

    async def _tell(self) -> None:
        """Twenty reports a second."""
        while True:
            now = self._clock()
            found = report(self.session, self._system.robot(), self._limits, now)
            found["picture_problem"] = self._picture_problem
            self._system.told()
            text = json.dumps(found, allow_nan=False)
            for outbox in self._outboxes.values():
                outbox.renew("status", text)
            await asyncio.sleep(STATUS)

    async def _list(self) -> None:
        """The recorded episodes, when they have changed."""
        loop = asyncio.get_running_loop()
        while True:
            entries = await loop.run_in_executor(None, self._system.entries)
            text = json.dumps({"say": "episodes", "episodes": [vars(each) for each in entries]})
            if text != self._episodes:
                self._episodes = text
                for outbox in self._outboxes.values():
                    outbox.renew("episodes", text)
            await asyncio.sleep(LIST)

    def _flush(self) -> None:
        orders = self.session.take_orders()
        if orders:
            self._system.obey(orders)

    # --- requests -----------------------------------------------------------------------------

    @web.middleware
    async def _guard(self, request: web.Request, handler: Any) -> web.StreamResponse:
        """Answer only who has come under one of our names, and sockets from our own pages."""
        if not self._access.host_allowed(request.headers.get("Host")):
            text = "421: this console is not known under that name; open the address it has printed"
            return web.Response(status=421, text=text + "\n")
        if request.path in ("/control", "/pictures") and not self._access.origin_allowed(
            request.headers.get("Origin")
        ):
            return web.Response(status=403, text="403: only the console's own page may connect\n")
        response: web.StreamResponse = await handler(request)
        return response

    async def _page(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info.get("name", "index.html")
        content = self._files.get(name)
        if content is None:
            return web.Response(status=404, text="404: the console has no such file\n")
        kind = TYPES[name.rpartition(".")[2]]
        return web.Response(body=content, content_type=kind, charset="utf-8")

    async def _admit(self, request: web.Request) -> web.WebSocketResponse | None:
        """Open a socket and hear the page's first words; None: it was closed again."""
        socket = web.WebSocketResponse(max_msg_size=4 * LONGEST, heartbeat=10.0, compress=False)
        await socket.prepare(request)
        try:
            said = parse(await asyncio.wait_for(socket.receive_str(), HELLO_WAIT))
        except (TimeoutError, TypeError, ProtocolError):
            said = None
        if not isinstance(said, Hello) or not self._access.token_allowed(said.token):
            await asyncio.sleep(0.5)  # guessing is slow
            await socket.close(code=CLOSE_HELLO, message=b"open the whole address, with its token")
            return None
        return socket

    async def _control(self, request: web.Request) -> web.StreamResponse:
        """A page's input and status."""
        socket = await self._admit(request)
        if socket is None:
            return web.Response()
        if self.session.pages >= MOST_PAGES:
            await socket.close(code=CLOSE_FULL, message=b"too many pages are open")
            return socket
        self._joined += 1
        name, outbox = f"page {self._joined}", _Outbox()
        self.session.join(name, self._clock())
        self._outboxes[name] = outbox
        self._sockets.add(socket)
        outbox.answer(json.dumps({"say": "welcome", "page": name, **self._facts}))
        if self._episodes:
            outbox.renew("episodes", self._episodes)
        sender = asyncio.create_task(_send(socket, outbox))
        try:
            await self._hear(socket, name, outbox)
        finally:
            self.session.leave(name, self._clock())
            self._flush()
            del self._outboxes[name]
            self._sockets.discard(socket)
            sender.cancel()
        return socket

    async def _hear(self, socket: web.WebSocketResponse, name: str, outbox: _Outbox) -> None:
        """Everything that a page says, until it is gone or talks nonsense."""
        allowance, mistakes = Allowance(self._clock()), 0
        async for message in socket:
            now = self._clock()
            if not allowance.spend(now):
                await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"too many messages")
                return
            try:
                if message.type is not WSMsgType.TEXT:
                    raise ProtocolError("a message is a text")
                self._heed(parse(message.data), name, outbox, now)
            except ProtocolError as error:
                mistakes += 1
                outbox.answer(json.dumps({"say": "refused", "why": str(error)}))
                if mistakes >= MOST_MISTAKES:
                    await socket.close(
                        code=WSCloseCode.POLICY_VIOLATION, message=b"no page of ours"
                    )
                    return

    def _heed(self, said: Said, name: str, outbox: _Outbox, now: float) -> None:
        """One message of a page; while the console ends nobody watches any more what it orders."""
        session, why = self.session, ""
        if self._ending and not (isinstance(said, Press) and said.button == "stop"):
            return
        if isinstance(said, Input):
            session.receive(name, said, now)
        elif isinstance(said, Press):
            why = self._press(said, name, now)
        elif isinstance(said, Hidden):
            session.hide(name, said.why)
        elif isinstance(said, Scale):
            why = session.scale(name, said.value)
        elif isinstance(said, Ping):
            outbox.answer(json.dumps({"say": "pong", "at": said.at, "wall_us": _wall_us()}))
        else:
            raise ProtocolError(f"{type(said).__name__.lower()} does not belong on this socket")
        self._flush()
        if why:
            outbox.answer(json.dumps({"say": "refused", "why": why}))

    def _press(self, said: Press, name: str, now: float) -> str:
        """A button; returns why it was refused."""
        session, robot = self.session, self._system.robot()
        in_time = session.in_time(name, said.at, now)
        if said.button == "stop":  # however late
            session.stop(robot, name)
            return ""
        if said.button == "release":
            session.release(name)
            return ""
        if not in_time:
            return operator_messages.LATE
        if said.button == "take":
            return session.take(name, now)
        if said.button == "enable":
            return session.enable(name, robot, now)
        if said.button == "put_back":
            return session.put_back(name, robot)
        if said.button == "policy":
            return session.policy(name, robot, now)
        return session.record(name, said.button == "record")

    # --- pictures -----------------------------------------------------------------------------

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        """A page's pictures."""
        socket = await self._admit(request)
        if socket is None:
            return web.Response()
        if len(self._viewers) >= MOST_PAGES:
            await socket.close(code=CLOSE_FULL, message=b"too many pages are open")
            return socket
        viewer = _Viewer()
        self._viewers.add(viewer)
        self._sockets.add(socket)
        sender = asyncio.create_task(self._send_pictures(socket, viewer))
        allowance = Allowance(self._clock())
        try:
            async for message in socket:
                said = parse(message.data) if message.type is WSMsgType.TEXT else None
                if not allowance.spend(self._clock()):
                    break
                if isinstance(said, Watch):
                    viewer.watched, viewer.lane = (said.layout, said.codec), Lane()
                    self._want()
                elif isinstance(said, Shown):
                    viewer.lane.drawn(said.seq)
                    viewer.news.set()
                else:
                    break
        except ProtocolError:
            pass  # no page of ours: it gets no more pictures
        finally:
            self._viewers.discard(viewer)
            self._sockets.discard(socket)
            self._want()
            sender.cancel()
            await socket.close()
        return socket

    def _want(self) -> None:
        wanted = {viewer.watched for viewer in self._viewers if viewer.watched is not None}
        self._pictures.want(frozenset(wanted))

    async def _send_pictures(self, socket: web.WebSocketResponse, viewer: _Viewer) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                await viewer.news.wait()
                viewer.news.clear()
                packet = viewer.lane.take(self._clock())
                if packet is not None:
                    await socket.send_bytes(packet.pack())


async def _send(socket: web.WebSocketResponse, outbox: _Outbox) -> None:
    """What waits goes out, one after another."""
    with contextlib.suppress(ConnectionError):
        while True:
            for text in await outbox.next():
                await socket.send_str(text)


async def _add_headers(request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)
    response.headers.popall("Server", None)


def _page_files() -> dict[str, bytes]:
    """The page's files, read once: what is not among them does not exist."""
    folder = resources.files(__package__).joinpath("page")
    return {
        file.name: file.read_bytes()
        for file in folder.iterdir()
        if file.name.rpartition(".")[2] in TYPES
    }


def _tls(access: Access) -> ssl.SSLContext | None:
    if access.certificate is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_cert_chain(*access.certificate)
    return context


def _wall_us() -> int:
    return time.time_ns() // 1000
