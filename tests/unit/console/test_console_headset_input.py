"""A headset's page that sends what no headset sends: refused with a reason, and the arm holds."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator

import pytest

from helpers.async_tests import within
from helpers.teleop.console import Console, console
from helpers.teleop.console_page import Page, page, when
from surg_console.session.console_orders import Move, SetOperatorPresent
from surg_console.session.console_session import Phase
from surg_console.web.control_socket import MAX_ERRORS

STRAIGHT = [0.0, 0.0, 0.0, 1.0]


@contextlib.asynccontextmanager
async def squeezed() -> AsyncIterator[tuple[Console, Page]]:
    """A headset's page that drives, its right hand squeezed."""
    async with console() as made, page(made.port) as found:
        found.hand = {"hand": "position", "q": STRAIGHT, "squeeze": False}
        await found.drive()

        async def follows() -> bool:
            if found.status["phase"] != "driving":  # a busy machine may let go in between
                await found.drive()
            found.hand["squeeze"] = False
            await asyncio.sleep(0.1)
            found.hand["squeeze"] = True
            await asyncio.sleep(0.5)
            dead_man = made.session._pages[found.name].dead_man
            return bool(found.status["phase"] == "driving" and dead_man and dead_man.engaged)

        for _ in range(10):
            if await follows():
                break
        yield made, found


async def holds(made: Console, began: float) -> None:
    """The arm holds, nothing moves afterwards, and the console goes on."""
    await when(lambda: made.session.phase is not Phase.DRIVING, "the hold", 5.0)
    await when(
        lambda: made.system.last(SetOperatorPresent)[1] == SetOperatorPresent(False),
        "its order",
        5.0,
    )
    assert made.system.last(SetOperatorPresent)[0] >= began
    await asyncio.sleep(0.3)
    held = made.system.last(SetOperatorPresent)[0]
    assert made.system.last(Move)[0] <= held + 0.02, "nothing moves after the hold"
    async with page(made.port) as other:
        assert other.status["phase"] != "driving"


BAD = {
    "a quaternion of length 1.5; allowed: 1": [0.0, 0.0, 0.0, 1.5],
    "a quaternion of length 0; allowed: 1": [0.0, 0.0, 0.0, 0.0],
    "allowed: four numbers": [0.0, 0.0, 1.0],
    "q: 1e+300; allowed: -2 to 2": [0.5, 0.5, 0.5, 1e300],
}
"""What the page is told, and the quaternion that it has sent."""


@within(60.0)
async def test_a_quaternion_that_is_none_moves_nothing_and_many_end_the_page() -> None:
    async with squeezed() as (made, found):
        still = made.system.last(Move)[1].sample.p
        for said, q in BAD.items():  # among good ones
            await found.input(q=q, p=[0.4, 0.4, 0.4])
            await when(lambda said=said: any(said in why for why in found.refused), said)
        await asyncio.sleep(0.1)
        assert made.system.last(Move)[1].sample.p == pytest.approx(still, abs=1e-9)
        assert len(BAD) == MAX_ERRORS - 1 and not found.socket.closed
        began = time.monotonic()
        await found.input(q=[0.0, 0.0, 0.0, 2.0])
        await when(lambda: found.socket.closed, "the end of the page")
        await holds(made, began)
        assert made.system.last(Move)[1].sample.p == pytest.approx(still, abs=1e-9)
