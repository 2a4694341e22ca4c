"""A console without ROS: a system and pictures that a test holds in its hands."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from helpers.teleop.chromium import Chromium, Tab, until
from surg_cli.graph import master
from surg_console.session.console_orders import EnableTeleop, Order
from surg_console.session.console_session import ConsoleSession, Phase
from surg_console.session.episode_list import Entry
from surg_console.session.system_state import Arm, Follower, Gauges, Robot
from surg_console.session.task_view import TaskView
from surg_console.session.tip_force_feedback import tip_force_feedback
from surg_console.web import access
from surg_console.web.console_server import ConsoleServer
from surg_console.web.picture_streams import EYES, CameraFrame, PictureStream

LIMITS = {
    "rcm_error_warn": 0.001,
    "rcm_error_fault": 0.002,
    "trocar_force_warn": 10.0,
    "trocar_force_fault": 15.0,
    "tip_force_soft": 5.0,
    "tip_force_hard": 8.0,
    "depth_min": 0.02,
    "depth_max": 0.22,
    "clearance": 0.02,
}
FACTS = {
    "cell": "test_cell",
    "arm": "PSM1",
    "views": ["left", "right"],
    "leads": True,
    "overlays": ["marks", "plan", "scene"],
    "limits": LIMITS,
}


LANGUAGE = {
    "instruction": "Grasp the bowel, and retract it.",
    "stages": {"grasp": "Grasp the bowel.", "retract": "Retract the bowel."},
}
"""Of the task, where a test says that there is one."""


class FakeSystem:
    """An arm and a teleoperation that obey at once; keeps every order with its time."""

    def __init__(self) -> None:
        self.orders: list[tuple[float, Order]] = []
        self.episodes: list[Entry] = []
        self.judged: list[str] = []
        self.watched: frozenset[str] = frozenset()
        self.shown: dict[str, str] = {}
        self.now = Robot(
            arms=(Arm("PSM1", "ENABLED", True, time.monotonic()),),
            follower=Follower("DISABLED", scale=0.2),
            gauges=Gauges(0.00012, 0.00015, 0.112, 1.4, 0.3),
        )

    def robot(self) -> Robot:
        """See `RunningSystem`."""
        arms = tuple(replace(arm, heard=time.monotonic()) for arm in self.now.arms)
        return replace(self.now, arms=arms)

    def reset_peaks(self) -> None:
        """See `RunningSystem`."""

    def keep_alive(self) -> None:
        """See `RunningSystem`."""

    def publish_orders(self, orders: list[Order]) -> None:
        """See `RunningSystem`."""
        for order in orders:
            self.orders.append((time.monotonic(), order))
            if isinstance(order, EnableTeleop):
                state = "FOLLOWING" if order.value else "DISABLED"
                self.now = replace(self.now, follower=replace(self.now.follower, state=state))

    def watch(self, what: str, wanted: bool) -> None:
        """See `RunningSystem`."""
        self.watched = self.watched | {what} if wanted else self.watched - {what}

    def overlay(self, what: str) -> str:
        """See `RunningSystem`."""
        if what == "feel" and what not in self.shown:
            now = time.monotonic()
            following = self.now.follower.state == "FOLLOWING"
            # Heard at the last of a clock's ticks, 500 a second.
            return json.dumps(
                tip_force_feedback(self.now.gauges.tip, now - now % 0.002, now, following)
            )
        return self.shown.get(what, "")

    def entries(self) -> list[Entry]:
        """See `RunningSystem`."""
        return self.episodes

    def judge(self, word: str) -> str:
        """See `RunningSystem`."""
        self.judged.append(word)
        return ""

    def given(self, kind: type) -> list[Any]:
        """The orders of one kind, in order."""
        return [order for _, order in self.orders if isinstance(order, kind)]

    def last(self, kind: type) -> tuple[float, Any]:
        """The newest order of a kind, with its time."""
        return next((at, order) for at, order in reversed(self.orders) if isinstance(order, kind))


class FakeCamera:
    """Pictures with a moving bar, encoded for whoever watches.

    Attributes:
        eyes: Pictures of the left and the right eye instead, each (h, w, 3); None: the bar in both.
    """

    def __init__(self, size: tuple[int, int] = (320, 240), period: float = 0.05) -> None:
        self.running = True
        self.eyes: tuple[np.ndarray, np.ndarray] | None = None
        self.keys: list[tuple[str, str]] = []
        self.wanted: Mapping[tuple[str, str], int] = {}
        self._streams: dict[tuple[str, str], PictureStream] = {}
        self._size, self._period = size, period

    def want(self, wanted: Mapping[tuple[str, str], int]) -> None:
        """See `server.Pictures`."""
        self.wanted = wanted

    def key(self, layout: str, codec: str) -> None:
        """See `server.Pictures`."""
        self.keys.append((layout, codec))
        if (layout, codec) in self._streams:
            self._streams[layout, codec].request_key()

    def picture(self, count: int) -> np.ndarray:
        """Grey, with a green bar that goes to the right."""
        width, height = self._size
        pixels = np.full((height, width, 3), 60, np.uint8)
        left = (4 * count) % (width - 16)
        pixels[:, left : left + 16] = (40, 200, 90)
        return pixels

    async def run(self, server: ConsoleServer) -> None:
        """Twenty pictures a second, until cancelled."""
        count = 0
        while True:
            await asyncio.sleep(self._period)
            if not self.running:
                continue
            count += 1
            now_us = time.time_ns() // 1000
            seen = self.eyes or (self.picture(count),) * 2
            shots = tuple(CameraFrame(now_us, now_us, eye, "rgb8") for eye in seen)
            for pair, spacing in self.wanted.items():
                if pair not in self._streams:
                    self._streams[pair] = PictureStream(*pair)
                self._streams[pair].space(spacing)
                packet = self._streams[pair].encode(shots[: len(EYES[pair[0]])])
                if packet is not None:
                    server.show(packet)


class Console:
    """A running console.

    Attributes:
        url: Of the page.
        port: TCP port.
        system: Its robot's side.
        camera: Its pictures.
        session: Who drives.
        stop: Ends it when set.
    """

    def __init__(self, rules: access.Access, pictures: bool, facts: Mapping[str, Any]) -> None:
        self.url, self.port = rules.url, rules.port
        self.system, self.camera = FakeSystem(), FakeCamera()
        self.session, self.stop = ConsoleSession(pictures), asyncio.Event()
        task = TaskView(json.dumps(LANGUAGE))
        self.server = ConsoleServer(
            rules, self.session, self.system, self.camera, {**FACTS, **facts}, LIMITS, task
        )


@contextlib.asynccontextmanager
async def console(
    pictures: bool = True, facts: Mapping[str, Any] | None = None, **how: Any
) -> AsyncIterator[Console]:
    """A console on a free port of the loopback.

    Args:
        pictures: Whether nothing may move without a picture.
        facts: That differ from `FACTS`.
        **how: Of `access.rules`.
    """
    made = Console(access.rules("127.0.0.1", master.free_port(), **how), pictures, facts or {})
    serving = asyncio.create_task(made.server.serve(made.stop))
    filming = asyncio.create_task(made.camera.run(made.server))
    try:
        while not master.port_in_use(made.port):
            assert not serving.done(), serving
            await asyncio.sleep(0.01)
        yield made
    finally:
        made.stop.set()
        filming.cancel()
        await serving


@contextlib.asynccontextmanager
async def opened(
    before: str = "", screen: tuple[int, ...] = ()
) -> AsyncIterator[tuple[Console, Chromium, Tab]]:
    """The page with pictures; its browser must not have logged an error at the end."""
    async with console() as made, Chromium() as browser:
        tab = await browser.open(made.url, before, screen=screen)
        await tab.until("surgConsole.picture.drawn.length > 3", "pictures", 60.0)
        yield made, browser, tab
        assert browser.errors == []


async def drive(
    made: Console, tab: Tab, enable: Callable[[], Awaitable[None]] | None = None
) -> None:
    """Enable, by Enter, until the tip follows: on a busy machine a gap may let go at once."""

    async def engaged() -> bool:
        if made.session.phase is not Phase.DRIVING:
            await (enable() if enable else tab.tap("Enter"))
            await asyncio.sleep(0.5)
        return made.session.phase is Phase.DRIVING

    await until(engaged, "driving", 60.0)
