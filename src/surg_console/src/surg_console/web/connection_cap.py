"""A cap on connections: one that is no page makes room for a newcomer.

On loopback an attacker and the operator have one address. So a newcomer displaces the oldest
connection that has not sent its request, and nobody is locked out by connections that send nothing.
"""

from __future__ import annotations

import asyncio

from aiohttp import web

MAX_OPEN = 256
"""Connections in all; admitted pages come on top."""
HEADER_WAIT = 10.0
"""[s] Timeout of a request's header, and of a TLS handshake: a busy machine's browser is slow."""
LATE = 0.1
"""[s] A server that comes so late to a timeout has not had time for the requests either."""


class ConnectionCap:
    """Makes the connections of a server, as `loop.create_server` asks for them."""

    def __init__(self, server: web.Server) -> None:
        self._server = server
        self._heard: set[object] = set()  # connections that have sent their request
        self._pages: set[object] = set()

    def __call__(self) -> asyncio.Protocol:
        """A new connection; at the cap an older one ends for it."""
        open_ones = self._server.connections  # the oldest first
        self._heard.intersection_update(open_ones)
        self._pages.intersection_update(open_ones)
        others = [each for each in open_ones if each not in self._pages and not _ends(each)]
        if len(others) >= MAX_OPEN:
            _abort(min(others, key=self._heard.__contains__))
        made = self._server()
        self._wait(made)
        return made

    def hear(self, request: web.Request) -> None:
        """A connection has sent its request: its header is in time."""
        self._heard.add(request.protocol)

    def keep(self, request: web.Request) -> None:
        """A connection has become a page: it never makes room."""
        self._pages.add(request.protocol)

    def _wait(self, made: web.RequestHandler) -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(HEADER_WAIT, self._expire, made, loop.time() + HEADER_WAIT)

    def _expire(self, made: web.RequestHandler, due: float) -> None:
        if made in self._heard or _ends(made):
            return
        if asyncio.get_running_loop().time() - due > LATE:
            self._wait(made)  # the server was busy itself: the request may have come long ago
        else:
            _abort(made)


def _ends(connection: web.RequestHandler) -> bool:
    return connection.transport is None or connection.transport.is_closing()


def _abort(connection: web.RequestHandler) -> None:
    if isinstance(connection.transport, asyncio.WriteTransport):
        connection.transport.abort()
