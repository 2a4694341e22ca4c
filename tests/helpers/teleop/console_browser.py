"""The operator's page in Chromium, before a console whose robot a test holds in its hands."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable

from helpers.teleop.chromium import Chromium, Tab, until
from helpers.teleop.console import Console, console
from surg_console.session.console_session import Phase


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
