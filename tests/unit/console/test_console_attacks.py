"""The console's server under attack from its own loopback: half-open requests and floods."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Coroutine
from typing import Any

import aiohttp
import pytest

from helpers.teleop.console import Console, console
from helpers.teleop.console_attack import attack
from helpers.teleop.console_page import page, when
from surg_console.session.console_orders import Present
from surg_console.web.connection_limits import (
    HEADER_WAIT,
    MAX_OPEN,
    MAX_PER_ADDRESS,
    Connections,
    Pace,
    Stage,
)
from surg_console.web.web_server import MAX_PAGES

pytestmark = pytest.mark.timed

CONNECT_WITHIN = 2.0
"""[s] A new page has the page's files, and a status on its socket."""
LONGEST = 3 * CONNECT_WITHIN
"""[s] The worst of several beside other tests."""


def run(test: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(test, 60.0))


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
def test_a_new_page_connects_under_half_open_requests_and_a_flood(flood: str) -> None:
    async def test() -> None:
        async with console(pictures=False) as made:
            async with attack(made.port, 30.0, half_open=1200, **{flood: 8}):
                times = [await open_a_page(made) for _ in range(3)]
            print(f"{flood}: a new page after {[round(t, 2) for t in times]} s")
            assert sorted(times)[1] < CONNECT_WITHIN and max(times) < LONGEST

    run(test())


def test_new_pages_get_room_in_the_order_of_arrival() -> None:
    """Who leaves a full console and comes back at once waits behind those that waited before."""

    async def enter(made: Console) -> contextlib.AsyncExitStack:
        async with contextlib.AsyncExitStack() as stack:
            await stack.enter_async_context(page(made.port))
            return stack.pop_all()

    async def test() -> None:
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

    run(test())


def test_the_driving_page_is_held_at_most_once() -> None:
    async def test() -> None:
        async with console(pictures=False) as made, page(made.port) as driver:
            await driver.drive()
            made.system.orders.clear()
            async with attack(made.port, 30.0, half_open=1200, pages=4, requests=4):
                await asyncio.sleep(3.0)
                assert driver.status["holder"] == driver.name
            held = made.system.given(Present).count(Present(False))
            print(f"held {held} times")
            assert held <= 1

    run(test())


def test_half_open_requests_are_closed_in_time() -> None:
    async def test() -> None:
        async with console(pictures=False) as made:
            open_ones = [await asyncio.open_connection("127.0.0.1", made.port) for _ in range(300)]
            for _, writer in open_ones:
                writer.write(b"GET / HTTP/1.1\r\n")
            await asyncio.sleep(0.3)
            ended = [reader for reader, _ in open_ones if reader.at_eof() or reader.exception()]
            assert 300 - len(ended) <= MAX_PER_ADDRESS

            def all_ended() -> bool:
                return all(reader.at_eof() or reader.exception() for reader, _ in open_ones)

            await when(all_ended, "the end of all", HEADER_WAIT + 3.0)
            for _, writer in open_ones:
                writer.close()

    run(test())


def test_an_address_at_its_limit_displaces_only_its_own() -> None:
    connections = Connections()
    quiet = connections.enter("10.0.0.1", 0.0)[0]
    for count in range(2 * MAX_PER_ADDRESS):
        entry, evicted = connections.enter("10.0.0.2", 1.0 + count)
        assert entry is not None and quiet not in evicted
    assert len(connections) == MAX_PER_ADDRESS + 1


def test_at_the_limit_in_all_the_busiest_address_gives_way() -> None:
    connections = Connections()
    for count in range(MAX_PER_ADDRESS):
        connections.enter("10.0.0.1", float(count))
    for count in range(MAX_OPEN):
        entry, _ = connections.enter(f"10.1.{count // 200}.{count % 200}", 200.0)
        assert entry is not None
    assert len(connections) == MAX_OPEN


def test_a_request_in_service_is_not_displaced() -> None:
    connections = Connections()
    served = []
    for _ in range(MAX_PER_ADDRESS):
        entry, _ = connections.enter("10.0.0.1", 0.0)
        assert entry is not None
        connections.set_stage(entry, Stage.SERVING, 0.0)
        served.append(entry)
    assert connections.enter("10.0.0.1", 1.0) == (None, [])
    connections.set_stage(served[7], Stage.IDLE, 1.0)
    assert connections.enter("10.0.0.1", 2.0)[1] == [served[7]]


def test_a_page_leaves_the_count_and_is_never_overdue() -> None:
    connections = Connections()
    entry, _ = connections.enter("10.0.0.1", 0.0)
    other, _ = connections.enter("10.0.0.1", 0.0)
    assert entry is not None
    connections.remove(entry)
    assert connections.overdue(1e9) == [other]


def test_the_pace_lets_a_burst_pass_and_then_its_rate() -> None:
    pace = Pace(rate=100.0, burst=10)
    waits = [pace.wait(0.0) for _ in range(30)]
    assert waits[:10] == [0.0] * 10
    assert waits[29] == pytest.approx(0.2)
    assert pace.wait(1.0) == 0.0


def test_every_connection_of_a_burst_is_served() -> None:
    async def test() -> None:
        connector = aiohttp.TCPConnector(limit=0)
        async with (
            console(pictures=False) as made,
            aiohttp.ClientSession(connector=connector) as http,
        ):

            async def status() -> int:
                async with http.get(f"http://localhost:{made.port}/page/mark.svg") as answer:
                    return answer.status

            assert await asyncio.gather(*(status() for _ in range(40))) == [200] * 40

    run(test())
