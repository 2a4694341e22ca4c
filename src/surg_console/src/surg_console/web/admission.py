"""Admits pages to sockets: the first message is a `hello` with the token, and there is room."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from aiohttp import WSCloseCode, web

from surg_console.web.access import Access
from surg_console.web.page_protocol import LONGEST, Hello, ProtocolError, parse
from surg_console.web.page_server import GOODBYE_WAIT

MAX_PAGES = 8
"""Open pages on each kind of socket."""
HELLO_WAIT = 3.0
"""[s] Timeout of a page's `hello`."""
ROOM_WAIT, ROOM_PERIOD = 1.0, 0.01
"""[s] Longest wait of a new page for room: pages that flood leave within this time."""
ENDED: dict[str, Any] = {"code": WSCloseCode.GOING_AWAY, "message": b"The system has ended."}
"""How a socket is closed that no page has closed."""
CLOSE_HELLO, CLOSE_FULL = 4401, 4429
"""WebSocket close codes: wrong or missing token; too many pages."""


class Admission:
    """The open sockets, and the pages that wait for room."""

    def __init__(self, access: Access, keep: Callable[[web.Request], None]) -> None:
        self._access, self._keep = access, keep
        self._sockets: set[web.WebSocketResponse] = set()
        # By path of the socket: turns of new pages, the longest wait first.
        self._waiting: defaultdict[str, list[object]] = defaultdict(list)

    async def admit(
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
        self._keep(request)
        return socket

    def dismiss(self, socket: web.WebSocketResponse) -> None:
        """A page has left."""
        self._sockets.discard(socket)

    async def close_all(self) -> None:
        """Close all sockets at once: one on a dead link must not delay the others."""
        closing = [socket.close(**ENDED) for socket in self._sockets]
        with contextlib.suppress(TimeoutError):
            everyone = asyncio.gather(*closing, return_exceptions=True)
            await asyncio.wait_for(everyone, GOODBYE_WAIT)

    async def _room(self, path: str, open_pages: Callable[[], int]) -> bool:
        """Wait for room, in the order of arrival: who left must not come back before others."""
        turn, waiting = object(), self._waiting[path]
        waiting.append(turn)
        deadline = time.monotonic() + ROOM_WAIT
        try:
            while waiting[0] is not turn or open_pages() >= MAX_PAGES:
                if time.monotonic() >= deadline:
                    return False
                await asyncio.sleep(ROOM_PERIOD)
            return True
        finally:
            waiting.remove(turn)
