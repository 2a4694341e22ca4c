"""A page of the operator console as its server sees it: sockets and messages, no browser."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

import aiohttp

from helpers.teleop.chromium import until


class Page:
    """One page on the socket of input and status.

    Attributes:
        socket: The socket.
        name: What the console calls it.
        facts: The console's welcome.
        status: The newest report.
        episodes: The newest list of episodes.
        refused: Why presses were refused.
        hand: Keys of the inputs that `speak` sends.
    """

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.name, self.facts, self.status, self.episodes = "", {}, {}, []
        self.refused: list[str] = []
        self.hand: dict[str, object] = {"hand": "position"}
        self._seq = 0
        self._chores = [asyncio.create_task(self._read())]

    async def _read(self) -> None:
        async for message in self.socket:
            said = json.loads(message.data)
            if said["say"] == "welcome":
                self.name, self.facts = said["page"], said
            elif said["say"] == "status":
                self.status = said
            elif said["say"] == "episodes":
                self.episodes = said["episodes"]
            elif said["say"] == "refused":
                self.refused.append(said["why"])

    async def say(self, what: str, **keys: object) -> None:
        """One message."""
        await self.socket.send_str(json.dumps({"say": what, **keys}))

    async def press(self, button: str) -> None:
        """A button."""
        await self.say("press", button=button, at=time.monotonic())

    async def input(self, **keys: object) -> None:
        """One input, with a new picture before the operator's eye."""
        self._seq += 1
        stamp = time.time_ns() // 1000
        own = {"seq": self._seq, "at": time.monotonic(), "picture_us": stamp}
        await self.say("input", **{**own, **self.hand, **keys})

    def speak(self) -> None:
        """From now on: an input every 20 ms, as a page does."""

        async def speak() -> None:
            with contextlib.suppress(ConnectionError):
                while True:
                    await self.input()
                    await asyncio.sleep(0.02)

        self._chores.append(asyncio.create_task(speak()))

    def fall_silent(self) -> None:
        """No more inputs."""
        for chore in self._chores[1:]:
            chore.cancel()

    async def drive(self) -> None:
        """Enable until the tip follows: on a busy machine a gap may let go at once."""
        self.speak()
        for _ in range(40):
            await asyncio.sleep(0.3)
            await self.press("enable")
            with contextlib.suppress(AssertionError):
                await when(lambda: self.status["phase"] == "driving", "driving", 1.0)
                return
        raise AssertionError(self.status)


async def socket_of(
    http: aiohttp.ClientSession, port: int, path: str, token: str = ""
) -> aiohttp.ClientWebSocketResponse:
    """A socket of the console on this port of the loopback, as `control`; it has said hello."""
    origin = f"http://localhost:{port}"
    socket = await http.ws_connect(f"{origin}/{path}", origin=origin)
    await socket.send_str(json.dumps({"say": "hello", "token": token}))
    return socket


@contextlib.asynccontextmanager
async def page(port: int, token: str = "") -> AsyncIterator[Page]:
    """A page of the console on this port of the loopback, once it has been told how things are.

    Raises:
        aiohttp.ClientError: The console has closed it again.
    """
    async with aiohttp.ClientSession() as http:
        socket = await socket_of(http, port, "control", token)
        found = Page(socket)
        await when(lambda: found.status or socket.closed, "a status")
        if not found.status:
            raise aiohttp.ClientError(f"closed with {socket.close_code}")
        yield found
        found.fall_silent()


async def when(condition: Callable[[], Any], what: str, seconds: float = 20.0) -> None:
    """Wait until a condition is true.

    Raises:
        AssertionError: It does not become so; names it.
    """

    async def ask() -> Any:
        return condition()

    await until(ask, what, seconds, 0.005)
