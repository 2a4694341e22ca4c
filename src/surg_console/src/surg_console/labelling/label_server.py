"""The server of the label pages: this machine only, small, and bounded.

It listens on the loopback address. As with the console, the header Host must name it, a page that
saves must be its own (header Origin), a request must arrive in time, and connections are bounded.
"""

from __future__ import annotations

import contextlib
import http.server
import json
import re
import socket
import threading
from http import HTTPStatus
from typing import Any

from surg_recording.labelling.label_pages import LabelPages
from surg_recording.recording_errors import EpisodeError

HEADER_WAIT = 2.0
"""[s] Time until a request, with its body, has arrived."""
SEND_WAIT = 30.0
"""[s] Longest pause of a client that receives a page."""
MAX_BODY = 256 << 10
"""Largest body [bytes]."""
MAX_OPEN = 32
"""Connections at a time; further ones are closed at once."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src 'self' data:; media-src blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_EPISODE = re.compile(r"/episode/([1-9][0-9]{0,5})")


class LabelServer(http.server.ThreadingHTTPServer):
    """Serves ``/episode/<n>``: GET is its page, POST saves its labels."""

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, pages: LabelPages, port: int = 0) -> None:
        """Listen on ``port`` of the loopback address; 0: a free one. An OSError if it is taken."""
        self.pages = pages
        self._places = threading.BoundedSemaphore(MAX_OPEN)
        super().__init__(("127.0.0.1", port), _Handler)
        names = ("127.0.0.1", "localhost")
        self.hosts = frozenset(f"{name}:{self.server_port}" for name in names)

    @property
    def url(self) -> str:
        """Of the first episode without labels."""
        return f"http://127.0.0.1:{self.server_port}/episode/{self.pages.first()}"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, if there is a place."""
        if not self._places.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Give the place back."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that goes away is no error."""


class _Handler(http.server.BaseHTTPRequestHandler):
    """One connection, one request."""

    server: LabelServer
    server_version, sys_version = "surg", ""

    def setup(self) -> None:
        """Limit the time until the request has arrived, also of one that comes byte by byte."""
        super().setup()
        self._arrival = threading.Timer(HEADER_WAIT, self._end)
        self._arrival.start()

    def _end(self) -> None:
        with contextlib.suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)

    def finish(self) -> None:
        """End the connection."""
        self._arrival.cancel()
        super().finish()

    def do_GET(self) -> None:
        """A page; ``/`` leads to the first one without labels."""
        if not self._is_for_us():
            return
        if self.path == "/":
            self._answer(HTTPStatus.FOUND, b"", Location=self.server.url)
        elif self.path == "/favicon.ico":  # browsers ask for it
            self._answer(HTTPStatus.NO_CONTENT, b"")
        elif (number := self._number()) is not None:
            self._arrival.cancel()
            page = self.server.pages.page(number).encode()
            self.connection.settimeout(SEND_WAIT)
            self._answer(HTTPStatus.OK, page)
            self._prepare(number + 1)

    def do_POST(self) -> None:
        """Save the labels of an episode."""
        if not self._is_for_us() or (number := self._number()) is None:
            return
        origin = self.headers.get("Origin", "").removeprefix("http://")
        length = self.headers.get("Content-Length", "")
        if origin not in self.server.hosts:
            self._refuse(HTTPStatus.FORBIDDEN, "the page is of another origin")
        elif self.headers.get_content_type() != "application/json":
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "application/json is needed")
        elif not length.isdecimal() or int(length) > MAX_BODY:
            said = f"a body of at most {MAX_BODY} bytes is needed"
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, said)
        else:
            self._save(number, int(length))

    def _save(self, number: int, length: int) -> None:
        try:
            stated = json.loads(self.rfile.read(length))
            self._arrival.cancel()
            self.server.pages.save(number, stated)
        except (ValueError, RecursionError) as problem:
            self._refuse(HTTPStatus.BAD_REQUEST, f"not saved: {problem}")
        except (EpisodeError, OSError) as problem:
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, f"not saved: {problem}")
        else:
            badge = json.dumps(self.server.pages.badge(number)).encode()
            self._answer(HTTPStatus.OK, badge, kind="application/json")

    def _prepare(self, number: int) -> None:
        """Make the next page while this one is looked at."""
        if number <= len(self.server.pages.folders):
            self.connection.shutdown(socket.SHUT_WR)
            self.server.pages.page(number)

    def _is_for_us(self) -> bool:
        if (self.headers.get("Host") or "").lower() in self.server.hosts:
            return True
        self._refuse(HTTPStatus.MISDIRECTED_REQUEST, "another Host")
        return False

    def _number(self) -> int | None:
        match = _EPISODE.fullmatch(self.path)
        if match is not None and int(match[1]) <= len(self.server.pages.folders):
            return int(match[1])
        self._refuse(HTTPStatus.NOT_FOUND, "no such episode")
        return None

    def _refuse(self, status: HTTPStatus, reason: str) -> None:
        self._answer(status, reason.encode(), kind="text/plain")

    def _answer(
        self, status: HTTPStatus, body: bytes, kind: str = "text/html", **more: str
    ) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, **more}.items():
            self.send_header(name, value)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)
        self.wfile.flush()

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the page shows what was saved."""
