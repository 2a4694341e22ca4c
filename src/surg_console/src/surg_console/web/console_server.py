"""The operator's pages and their sockets. No ROS.

``/`` and ``/page/…`` serve the page, ``/control`` its input and status, ``/pictures`` the
endoscope's pictures. ``/marks``, ``/plan`` and ``/scene`` are what is shown over and beside them,
``/feel`` is what is heard and rumbles. ``/calibrate`` is the page that collects calibration views,
``/calibration`` its socket. ``/monitor`` shows the pictures on a 3D monitor, ``/status`` is its
socket: status out, Stop in. The pages are public; all sockets demand the token in a first
`hello`.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any

from aiohttp import web

from surg_console.session.console_orders import EnableTeleop, SetOperatorPresent
from surg_console.session.console_session import ConsoleSession
from surg_console.session.page_status import report
from surg_console.session.task_view import TaskView
from surg_console.web.access import Access
from surg_console.web.admission import Admission
from surg_console.web.calibration_socket import CalibrationPages
from surg_console.web.control_socket import ControlPages
from surg_console.web.encoder_process import EncoderProcess
from surg_console.web.overlay_socket import PERIODS, OverlayPages
from surg_console.web.page_protocol import LONGEST
from surg_console.web.page_server import PageServer, listen
from surg_console.web.picture_packet import Packet
from surg_console.web.picture_socket import PicturePages
from surg_console.web.running_system import RunningSystem

TICK = 0.01
"""[s] Period of the session."""
STATUS = 0.05
"""[s] Period of the status reports."""
LIST = 1.0
"""[s] Period of the list of episodes."""

PAGES = {
    "/": "index.html",
    "/calibrate": "calibrate/calibrate.html",
    "/monitor": "monitor.html",
    "/headset": "headset.html",
}
Serve = Callable[[web.WebSocketResponse], Awaitable[None]]
"""Serves one admitted page until it ends."""


class ConsoleServer:
    """One console.

    Args:
        facts: Sent to the page once: cell, arm, views, ….
        limits: Of the driven arm [SI].
        task: Its words.
    """

    def __init__(
        self,
        access: Access,
        session: ConsoleSession,
        system: RunningSystem,
        pictures: EncoderProcess,
        facts: Mapping[str, Any],
        limits: Mapping[str, float],
        task: TaskView,
    ) -> None:
        self._session, self._access, self._system = session, access, system
        self._limits = limits
        self._picture_problem, self._task = "", task
        self._control = ControlPages(session, system, facts)
        self._pictures = PicturePages(pictures)
        self._calibrators = CalibrationPages(system, {"cell": facts["cell"]})
        self._overlays = OverlayPages(system)
        self._server = PageServer(access, PAGES, self._routes(), LONGEST)
        self._admission = Admission(access, self._server.keep)

    def _routes(self) -> list[web.RouteDef]:
        """The sockets."""
        control, pictures, calibrators = self._control, self._pictures, self._calibrators
        serve = self._overlays.serve
        return [
            self._socket("/control", control.serve, lambda: self._session.pages),
            self._socket("/status", control.serve_monitor, lambda: control.monitors),
            self._socket("/pictures", pictures.serve, lambda: pictures.open),
            self._socket("/calibration", calibrators.serve, lambda: calibrators.open),
            *(
                self._socket(f"/{what}", partial(serve, what), partial(self._overlays.open, what))
                for what in PERIODS
            ),
        ]

    def _socket(self, path: str, serve: Serve, open_pages: Callable[[], int]) -> web.RouteDef:
        async def handle(request: web.Request) -> web.StreamResponse:
            socket = await self._admission.admit(request, open_pages)
            if socket is None:
                return web.Response()
            try:
                await serve(socket)
            finally:
                self._admission.dismiss(socket)
            return socket

        return web.get(path, handle)

    async def serve(self, stop: asyncio.Event) -> None:
        """Serve until `stop` is set or a task fails; either way the arm holds afterwards.

        Raises:
            OSError: The address or port is not available.
        """
        async with self._server.serving(listen(self._access.bind, self._access.port)):
            loops = (self._session_loop, self._status_loop, self._episodes_loop)
            tasks = [asyncio.create_task(loop()) for loop in loops]
            try:
                ends = [asyncio.create_task(stop.wait()), *tasks]
                done, _ = await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()  # raises what a failed task has raised
            finally:
                self._control.ending = True
                self._system.publish_orders([SetOperatorPresent(False), EnableTeleop(False)])
                for task in tasks:
                    task.cancel()
                await self._admission.close_all()

    def show(self, packet: Packet) -> None:
        """Send a new picture to everybody who watches its layout and codec."""
        self._pictures.show(packet)

    def picture_problem(self, text: str) -> None:
        """Set why there are no pictures; empty: there are."""
        self._picture_problem = text

    async def _session_loop(self) -> None:
        while True:
            self._session.tick(self._system.robot(), time.monotonic())
            self._control.send_orders()
            self._system.keep_alive()
            self._pictures.request_keys()
            await asyncio.sleep(TICK)

    async def _status_loop(self) -> None:
        while True:
            robot, now = self._system.robot(), time.monotonic()
            status = report(self._session, robot, self._limits, now)
            status["task"] = self._task.report(robot, now)
            status["picture_problem"] = self._picture_problem
            self._system.reset_peaks()
            self._control.update_all("status", json.dumps(status, allow_nan=False))
            await asyncio.sleep(STATUS)

    async def _episodes_loop(self) -> None:
        loop, sent = asyncio.get_running_loop(), ""
        while True:
            entries = await loop.run_in_executor(None, self._system.entries)
            text = json.dumps({"say": "episodes", "episodes": [vars(entry) for entry in entries]})
            if text != sent:
                sent = text
                self._control.update_all("episodes", text)
            await asyncio.sleep(LIST)
