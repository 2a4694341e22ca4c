"""Accepts the console's connections within the limits of `connection_limits`."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import ssl
import time
from typing import Any

from aiohttp import web
from aiohttp.web_protocol import RequestHandler

from surg_console.web.connection_limits import (
    HEADER_WAIT,
    IDLE_WAIT,
    MAX_PIPELINED,
    REQUEST_BURST,
    REQUEST_RATE,
    Connections,
    Entry,
    Pace,
    Stage,
)

BACKLOG = 1024
"""Connections that the kernel keeps until they are accepted; beyond it a client waits 1 s."""
ACCEPTED_AT_ONCE, ACCEPT_PAUSE = 16, 0.005
"""Connections accepted in a row, and the pause [s] after them for everything else."""
RECEIVE_BUFFER = 16 * 1024
"""[B] Receive buffer of a connection: bounds the work of one read. A page sends short texts."""
SWEEP = 0.25
"""[s] Period of the check of timeouts."""


class Connection(RequestHandler):
    """One HTTP connection that keeps the limits of its listener."""

    __slots__ = ("_entry", "_listener", "_unanswered")

    def __init__(self, listener: Listener, entry: Entry, server: web.Server) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(
            server,
            loop=loop,
            keepalive_timeout=IDLE_WAIT,
            lingering_time=0.1,
            access_log=None,  # type: ignore[arg-type]  # aiohttp's own annotation lacks None
        )
        self._listener, self._entry, self._unanswered = listener, entry, 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Announce the transport, so that the listener can close it."""
        super().connection_made(transport)
        self._listener.opened(self._entry, transport)

    def connection_lost(self, exc: BaseException | None) -> None:
        """Leave the count."""
        self._listener.forget(self._entry)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Parse, unless the client sends many requests without waiting for the answers."""
        if self._listener.counts(self._entry):
            self._unanswered += data.count(b"\r\n\r\n")
            if self._unanswered > MAX_PIPELINED:
                self.force_close()
                return
        super().data_received(data)

    async def begin(self) -> None:
        """Wait for the turn of a request."""
        self._listener.set_stage(self._entry, Stage.SERVING)
        await self._listener.turn()

    def end(self) -> None:
        """A request has been answered."""
        self._unanswered -= 1
        self._listener.set_stage(self._entry, Stage.IDLE)

    def become_page(self) -> None:
        """Leave the count and the timeouts: the token was right, and there was room."""
        self._listener.forget(self._entry)


class Listener:
    """The listening sockets of a console and the connections that they have accepted."""

    def __init__(self, server: web.Server, tls: ssl.SSLContext | None) -> None:
        self._server, self._tls = server, tls
        self._connections = Connections()
        self._transports: dict[Entry, asyncio.BaseTransport] = {}
        self._pace = Pace(REQUEST_RATE, REQUEST_BURST)
        self._handshakes: set[asyncio.Task[None]] = set()

    async def serve(self, sockets: list[socket.socket]) -> None:
        """Accept connections and close overdue ones until cancelled; closes the sockets."""
        try:
            await asyncio.gather(self._sweep(), *(self._accept(each) for each in sockets))
        finally:
            for each in sockets:
                each.close()

    def opened(self, entry: Entry, transport: asyncio.BaseTransport) -> None:
        """Keep the transport of a connection."""
        if self.counts(entry):
            self._transports[entry] = transport

    def counts(self, entry: Entry) -> bool:
        """Whether a connection is not a page."""
        return entry in self._connections

    def forget(self, entry: Entry) -> None:
        """A connection has ended, or has become a page."""
        self._connections.remove(entry)
        self._transports.pop(entry, None)

    def set_stage(self, entry: Entry, stage: Stage) -> None:
        """Start a stage of a connection and its timeout."""
        self._connections.set_stage(entry, stage, time.monotonic())

    async def turn(self) -> None:
        """Wait for the turn of one request."""
        await asyncio.sleep(self._pace.wait(time.monotonic()))

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(SWEEP)
            for entry in self._connections.overdue(time.monotonic()):
                self._abort(entry)

    async def _accept(self, listening: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        while True:
            connection, address = await loop.sock_accept(listening)
            self._admit(connection, str(address[0]))
            for _ in range(ACCEPTED_AT_ONCE - 1):
                try:
                    connection, address = listening.accept()
                except OSError:  # none waits, or it has gone, or no file descriptor is left
                    break
                self._admit(connection, str(address[0]))
            await asyncio.sleep(ACCEPT_PAUSE)

    def _admit(self, connection: socket.socket, address: str) -> None:
        entry, victims = self._connections.enter(address, time.monotonic())
        for victim in victims:
            self._abort(victim)
        if entry is None:
            connection.close()
            return
        connection.setblocking(False)
        task = asyncio.create_task(self._connect(connection, entry))
        self._handshakes.add(task)
        task.add_done_callback(self._handshakes.discard)

    async def _connect(self, connection: socket.socket, entry: Entry) -> None:
        loop = asyncio.get_running_loop()
        how: dict[str, Any] = {}
        if self._tls is not None:
            how = {"ssl": self._tls, "ssl_handshake_timeout": HEADER_WAIT}
        try:
            transport, _ = await loop.connect_accepted_socket(
                lambda: Connection(self, entry, self._server), connection, **how
            )
        except OSError:  # a client without TLS, or one that has gone
            self.forget(entry)
            connection.close()
            return
        if not self.counts(entry):  # displaced meanwhile
            transport.abort()

    def _abort(self, entry: Entry) -> None:
        transport = self._transports.pop(entry, None)
        if isinstance(transport, asyncio.WriteTransport):
            transport.abort()


def listen(bind: str, port: int) -> list[socket.socket]:
    """Open the listening sockets: `localhost` stands for both loopbacks.

    Raises:
        OSError: The address or port is not available.
    """
    sockets: list[socket.socket] = []
    for family, _, _, _, address in socket.getaddrinfo(bind, port, type=socket.SOCK_STREAM):
        try:
            made = socket.create_server(address[:2], family=family, backlog=BACKLOG)
        except OSError as error:
            if error.errno in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
                continue  # a machine without IPv6 still has `localhost`
            for each in sockets:
                with contextlib.suppress(OSError):
                    each.close()
            raise
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        made.setblocking(False)
        sockets.append(made)
    if not sockets:
        raise OSError(errno.EADDRNOTAVAIL, "this machine does not have the address")
    return sockets
