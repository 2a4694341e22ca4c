"""The label page's mode of the web server: this machine only, no ROS.

``/episode/<n>``: GET is its page, POST saves its labels.
"""

from __future__ import annotations

import asyncio
import json

from aiohttp import web

from surg_console.labelling.label_pages import LabelPages
from surg_console.web.access import rules
from surg_console.web.page_server import PageServer, listen
from surg_recording.recording_errors import EpisodeError

BIND = "127.0.0.1"
BODY_WAIT = 2.0
"""[s] Time until the body of a request has arrived."""
MAX_BODY = 256 << 10
"""Largest body [bytes]."""
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; media-src blob:; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
"""The page of an episode has its scripts, videos and pictures in itself."""


class LabelServer:
    """Serves the pages of episodes on the loopback address.

    Args:
        pages: The episodes.
    """

    def __init__(self, pages: LabelPages) -> None:
        self._pages = pages
        self._listening = listen(BIND, 0)
        self.port = int(self._listening[0].getsockname()[1])
        routes = [
            web.get("/", self._first),
            web.get("/favicon.ico", self._no_icon),  # browsers ask for it
            web.get(r"/episode/{number:[1-9][0-9]{0,5}}", self._show),
            web.post(r"/episode/{number:[1-9][0-9]{0,5}}", self._save),
        ]
        self._server = PageServer(rules(BIND, self.port), {}, routes, MAX_BODY)

    @property
    def url(self) -> str:
        """Of the first episode without labels."""
        return f"http://{BIND}:{self.port}/episode/{self._pages.first()}"

    async def serve(self) -> None:
        """Serve until cancelled."""
        async with self._server.serving(self._listening):
            await asyncio.Event().wait()

    async def _first(self, request: web.Request) -> web.Response:
        raise web.HTTPFound(self.url)

    async def _no_icon(self, request: web.Request) -> web.Response:
        return web.Response(status=204)

    async def _show(self, request: web.Request) -> web.Response:
        number, loop = self._number(request), asyncio.get_running_loop()
        page = await loop.run_in_executor(None, self._pages.page, number)
        if number < len(self._pages.folders):  # make the next one while this one is looked at
            loop.run_in_executor(None, self._pages.page, number + 1)
        headers = {"Content-Security-Policy": POLICY}
        return web.Response(text=page, content_type="text/html", headers=headers)

    async def _save(self, request: web.Request) -> web.Response:
        number = self._number(request)
        if request.content_type != "application/json":
            raise web.HTTPUnsupportedMediaType(text="application/json is needed")
        if request.content_length is None or request.content_length > MAX_BODY:
            said = f"a body of at most {MAX_BODY} bytes is needed"
            raise web.HTTPRequestEntityTooLarge(MAX_BODY, request.content_length or 0, text=said)
        try:
            body = await asyncio.wait_for(request.read(), BODY_WAIT)
            self._pages.save(number, json.loads(body))
        except TimeoutError:
            raise web.HTTPRequestTimeout(text="not saved: the body did not arrive") from None
        except (ValueError, RecursionError) as problem:
            raise web.HTTPBadRequest(text=f"not saved: {problem}") from None
        except (EpisodeError, OSError) as problem:
            raise web.HTTPInternalServerError(text=f"not saved: {problem}") from None
        return web.json_response(self._pages.badge(number))

    def _number(self, request: web.Request) -> int:
        number = int(request.match_info["number"])
        if number > len(self._pages.folders):
            raise web.HTTPNotFound(text="no such episode")
        return number
