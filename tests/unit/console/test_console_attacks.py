"""The console's server under attack from its own loopback: half-open requests and floods."""

from __future__ import annotations

import asyncio
import contextlib
import time
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest

from helpers.async_tests import within
from helpers.teleop.console import Console, console
from helpers.teleop.console_attack import attack
from helpers.teleop.console_page import page, when
from surg_console.session.console_orders import SetOperatorPresent
from surg_console.web import connection_cap
from surg_console.web.admission import MAX_PAGES
from surg_console.web.connection_cap import MAX_OPEN, ConnectionCap

pytestmark = pytest.mark.timed

CONNECT_WITHIN = 2.0
"""[s] A new page has the page's files, and a status on its socket."""
HEADER_WAIT = 1.0
"""[s] Instead of the server's."""
LONGEST = 3 * CONNECT_WITHIN
"""[s] The worst of several beside other tests."""


async def open_a_page(made: Console) -> float:
    """Time [s] until a new page has index.html, main.js, and its first status.

    After a reset, browsers ask for a file again, and the page connects again.
    """
    began = time.monotonic()
    async with aiohttp.ClientSession() as http:
        for path in ("/", "/page/main.js"):
            while time.monotonic() - began < LONGEST:
                with contextlib.suppress(aiohttp.ClientError):
                    async with http.get(f"http://localhost:{made.port}{path}") as answer:
                        assert answer.status == 200 and await answer.read()
                        break
    while True:
        try:
            async with page(made.port):
                return time.monotonic() - began
        except aiohttp.ClientError:
            assert time.monotonic() - began < LONGEST


@pytest.mark.parametrize("flood", ["connect", "requests", "pipelined", "pages"])
@within(60.0)
async def test_a_new_page_connects_under_half_open_requests_and_a_flood(flood: str) -> None:
    async with console(pictures=False) as made:
        async with attack(made.port, 30.0, half_open=1200, **{flood: 8}):
            times = [await open_a_page(made) for _ in range(3)]
        print(f"{flood}: a new page after {[round(t, 2) for t in times]} s")
        assert sorted(times)[1] < CONNECT_WITHIN and max(times) < LONGEST


@within(60.0)
async def test_new_pages_get_room_in_the_order_of_arrival() -> None:
    """Who leaves a full console and comes back at once waits behind those that waited before."""

    async def enter(made: Console) -> contextlib.AsyncExitStack:
        async with contextlib.AsyncExitStack() as stack:
            await stack.enter_async_context(page(made.port))
            return stack.pop_all()

    async with console(pictures=False) as made:
        inside = [await enter(made) for _ in range(MAX_PAGES)]
        for _ in range(10):
            first = asyncio.create_task(enter(made))
            await asyncio.sleep(0.15)
            await inside.pop(0).aclose()
            second = asyncio.create_task(enter(made))
            inside.append(await asyncio.wait_for(first, 0.5))
            assert not second.done()  # it came back after the first one
            await inside.pop(0).aclose()
            inside.append(await second)
        for stack in inside:
            await stack.aclose()


@within(60.0)
async def test_the_driving_page_is_held_at_most_once() -> None:
    async with console(pictures=False) as made, page(made.port) as driver:
        await driver.drive()
        made.system.orders.clear()
        async with attack(made.port, 30.0, half_open=1200, pages=4, requests=4):
            await asyncio.sleep(3.0)
            assert driver.status["holder"] == driver.name
        held = made.system.given(SetOperatorPresent).count(SetOperatorPresent(False))
        print(f"held {held} times")
        assert held <= 1


@pytest.fixture(autouse=True)
def short_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests wait a second for what is given ten."""
    monkeypatch.setattr(connection_cap, "HEADER_WAIT", HEADER_WAIT)


@within(60.0)
async def test_half_open_requests_are_closed_in_time() -> None:
    async with console(pictures=False) as made:
        count = MAX_OPEN + 50
        open_ones = [await asyncio.open_connection("127.0.0.1", made.port) for _ in range(count)]
        for _, writer in open_ones:
            writer.write(b"GET / HTTP/1.1\r\n")
        await asyncio.sleep(0.3)
        ended = [reader for reader, _ in open_ones if reader.at_eof() or reader.exception()]
        assert count - len(ended) <= MAX_OPEN

        def all_ended() -> bool:
            return all(reader.at_eof() or reader.exception() for reader, _ in open_ones)

        await when(all_ended, "the end of all", HEADER_WAIT + 3.0)
        for _, writer in open_ones:
            writer.close()


@within(60.0)
async def test_a_request_is_answered_although_the_machine_was_busy_when_it_came() -> None:
    """The server comes to it later than a connection that sends nothing is kept."""
    async with console(pictures=False) as made:
        reader, writer = await asyncio.open_connection("127.0.0.1", made.port)
        await asyncio.sleep(0.2)  # the connection is accepted
        writer.write(f"GET / HTTP/1.1\r\nHost: localhost:{made.port}\r\n\r\n".encode())
        time.sleep(HEADER_WAIT + 0.5)
        assert (await reader.readline()).startswith(b"HTTP/1.1 200")
        writer.close()


class Transport(asyncio.Transport):
    """A connection's transport that remembers that it was cut."""

    cut = False

    def abort(self) -> None:
        self.cut = True

    def is_closing(self) -> bool:
        return self.cut


class Connection:
    """A connection of `Requests`."""

    def __init__(self) -> None:
        self.transport = Transport()


class Requests:
    """What the cap needs of a web server: its connections, the oldest first."""

    def __init__(self) -> None:
        self.connections: list[Any] = []

    def __call__(self) -> Connection:
        self.connections.append(Connection())
        return self.connections[-1]


@within(60.0)
async def test_at_the_cap_who_sent_nothing_gives_way_then_the_oldest_and_never_a_page() -> None:
    server = Requests()
    cap = ConnectionCap(server)  # type: ignore[arg-type]
    page: Any = cap()
    cap.keep(SimpleNamespace(protocol=page))  # type: ignore[arg-type]
    others: list[Any] = [cap() for _ in range(MAX_OPEN)]
    made = [page, *others]
    for each in (page, *others[:3], *others[4:]):
        cap.hear(SimpleNamespace(protocol=each))  # type: ignore[arg-type]
    newcomers = [cap()]
    assert [each for each in made if each.transport.cut] == [others[3]]
    cap.hear(SimpleNamespace(protocol=newcomers[0]))  # type: ignore[arg-type]
    cap()
    assert [each for each in made if each.transport.cut] == [others[0], others[3]]
    await asyncio.sleep(HEADER_WAIT + 0.2)
    assert not page.transport.cut and not newcomers[0].transport.cut


@within(60.0)
async def test_every_connection_of_a_burst_is_served() -> None:
    connector = aiohttp.TCPConnector(limit=0)
    async with (
        console(pictures=False) as made,
        aiohttp.ClientSession(connector=connector) as http,
    ):

        async def status() -> int:
            async with http.get(f"http://localhost:{made.port}/page/mark.svg") as answer:
                return answer.status

        assert await asyncio.gather(*(status() for _ in range(40))) == [200] * 40
