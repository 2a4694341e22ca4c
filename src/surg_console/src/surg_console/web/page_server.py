"""The one web server of all pages: what the console and the label page have in common.

It answers only to its own names (header Host). Sockets and whatever changes something must come
from its own pages (header Origin). A connection carries one request, so nobody keeps one open.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from collections.abc import AsyncIterator, Iterable
from typing import Any

from aiohttp import web

from surg_console.web import http_policy
from surg_console.web.access import Access
from surg_console.web.connection_cap import HEADER_WAIT, ConnectionCap

BACKLOG = 128
"""Connections that the kernel keeps until they are accepted; as many are accepted in a row."""
RECEIVE_BUFFER = 16 * 1024
"""[B] Receive buffer of a connection: bounds the work of one read. A page sends short texts."""
GOODBYE_WAIT = 1.0
"""[s] Timeout of the end; a connection on a dead link would take minutes."""


class PageServer:
    """Serves routes, and the files of `page/` below ``/page/``.

    Args:
        access: Who may open the pages.
        pages: Files of `page/` by their path.
        routes: Everything else.
        longest: Longest body of a request [B].
    """

    def __init__(
        self, access: Access, pages: dict[str, str], routes: Iterable[web.RouteDef], longest: int
    ) -> None:
        self._access, self._pages = access, pages
        self._files = http_policy.page_files()
        self._cap: ConnectionCap | None = None
        self._app = web.Application(middlewares=[self._guard], client_max_size=longest)
        self._app.on_response_prepare.append(http_policy.add_headers)
        for path in (*pages, "/page/{name:.+}"):
            self._app.router.add_get(path, self._page)
        self._app.router.add_routes(routes)

    @contextlib.asynccontextmanager
    async def serving(self, sockets: list[socket.socket]) -> AsyncIterator[None]:
        """Serve on listening sockets, and close them and every connection at the end."""
        runner = web.AppRunner(self._app, access_log=None, handle_signals=False, lingering_time=0.1)
        await runner.setup()
        assert runner.server is not None
        self._cap = ConnectionCap(runner.server)
        tls = http_policy.tls_context(self._access)
        limits: dict[str, Any] = {"backlog": BACKLOG}
        if tls is not None:
            limits |= {"ssl": tls, "ssl_handshake_timeout": HEADER_WAIT}
        loop = asyncio.get_running_loop()
        listening = [await loop.create_server(self._cap, sock=each, **limits) for each in sockets]
        try:
            yield
        finally:
            for each in listening:
                each.close()
            await runner.server.shutdown(GOODBYE_WAIT)
            await runner.cleanup()

    def keep(self, request: web.Request) -> None:
        """A request has become an admitted page: its connection never makes room for others."""
        assert self._cap is not None
        self._cap.keep(request)

    @web.middleware
    async def _guard(self, request: web.Request, handler: Any) -> web.StreamResponse:
        assert self._cap is not None
        self._cap.hear(request)
        response: web.StreamResponse | None = self._rejection(request)
        try:
            if response is None:
                response = await handler(request)
        except web.HTTPException as problem:
            problem.force_close()
            raise
        assert response is not None
        response.force_close()
        return response

    def _rejection(self, request: web.Request) -> web.Response | None:
        """Reject unknown host names, and foreign pages that ask for more than a file."""
        if not self._access.host_allowed(request.headers.get("Host")):
            text = "421: unknown host name; open the address that the console has printed"
            return web.Response(status=421, text=text + "\n")
        reads = request.method in ("GET", "HEAD") and "Upgrade" not in request.headers
        if not reads and not self._access.origin_allowed(request.headers.get("Origin")):
            return web.Response(status=403, text="403: only the console's own page may connect\n")
        return None

    async def _page(self, request: web.Request) -> web.StreamResponse:
        name = self._pages.get(request.path) or request.match_info["name"]
        content = self._files.get(name)
        if content is None:
            return web.Response(status=404, text="404: no such file\n")
        content_type = http_policy.TYPES[name.rpartition(".")[2]]
        return web.Response(body=content, content_type=content_type, charset="utf-8")


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
