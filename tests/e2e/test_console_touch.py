"""The operator's page by fingers, and every function by key, in Chromium."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
from collections.abc import AsyncIterator, Coroutine
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium, Tab, until
from helpers.teleop.console import Console, console
from surg_teleop.console.session import operator_messages
from surg_teleop.console.session.console_orders import Camera, Clutch, Move, PutBack, SetScale
from surg_teleop.console.session.console_session import Phase

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]

SIZES = ((1366, 768, False), (1024, 768, True), (390, 844, True))
"""Screens: width, height [px], and whether they are touched."""


def run(test: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(test, 240.0))


async def _is(value: object) -> bool:
    return bool(value)


async def resize(tab: Tab, width: int, height: int, touch: bool) -> None:
    keys = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": touch}
    await tab.call("Emulation.setDeviceMetricsOverride", **keys)
    await tab.call("Emulation.setTouchEmulationEnabled", enabled=touch, maxTouchPoints=5)


@contextlib.asynccontextmanager
async def opened(touch: bool) -> AsyncIterator[tuple[Console, Tab]]:
    async with console() as made, Chromium() as browser:
        tab = await browser.open("about:blank")
        await resize(tab, 1024, 768, touch)
        await tab.call("Page.navigate", url=made.url)
        await tab.until("globalThis.surgConsole?.picture.drawn.length > 3", "pictures", 60.0)
        yield made, tab
        assert browser.errors == []


async def drive(made: Console, tab: Tab) -> None:
    async def engaged() -> bool:
        if made.session.phase is not Phase.DRIVING:
            await tab.tap("Enter")
            await asyncio.sleep(0.5)
        return made.session.phase is Phase.DRIVING

    await until(engaged, "driving", 60.0)


async def fingers(tab: Tab, kind: str, *places: tuple[float, float]) -> None:
    points = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(places)]
    await tab.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)


async def hand(tab: Tab) -> np.ndarray:
    """Where the handle is, once it stands still: x, y, z [m], roll [rad]."""
    await asyncio.sleep(0.3)
    await tab.until("Math.abs(surgConsole.hand.goal.x - surgConsole.hand.now.x) < 1e-5", "rest")
    return np.array(await tab.run("Object.values(surgConsole.hand.goal)"))


async def middle(tab: Tab, selector: str) -> tuple[float, float]:
    box = f"document.querySelector('{selector}').getBoundingClientRect()"
    x, y, w, h = await tab.run(
        f"(() => {{const b = {box}; return [b.x, b.y, b.width, b.height]}})()"
    )
    return x + w / 2, y + h / 2


def test_one_finger_moves_in_the_picture_and_two_along_and_about_it() -> None:
    async def test() -> None:
        async with opened(touch=True) as (made, tab):
            before = await hand(tab)
            await fingers(tab, "touchStart", (300, 400))
            for step in range(1, 6):
                await fingers(tab, "touchMove", (300 + 10 * step, 400 - 6 * step))
            after = await hand(tab)
            assert after - before == pytest.approx([0.025, -0.015, 0, 0], abs=1e-3)
            # A second finger: both up is deeper.
            await fingers(tab, "touchStart", (350, 370), (450, 370))
            for step in range(1, 6):
                await fingers(tab, "touchMove", (350, 370 - 8 * step), (450, 370 - 8 * step))
            deeper = await hand(tab)
            assert deeper - after == pytest.approx([0, 0, 0.02, 0], abs=1e-3)
            # Turned clockwise about their middle: roll about the view's z, which points away.
            for step in range(1, 11):
                c, s = (50 * f(0.05 * step) for f in (math.cos, math.sin))
                await fingers(tab, "touchMove", (400 - c, 330 - s), (400 + c, 330 + s))
            turned = await hand(tab)
            assert turned[3] - deeper[3] == pytest.approx(0.5, abs=0.03)
            assert turned[:3] == pytest.approx(deeper[:3], abs=1e-3)
            # One is lifted: what the other does until it is lifted too moves nothing.
            await tab.call(
                "Input.dispatchTouchEvent", type="touchEnd",
                touchPoints=[{"x": 400, "y": 330, "id": 0}],
            )  # fmt: skip
            await fingers(tab, "touchMove", (300, 300))
            assert await hand(tab) == pytest.approx(turned, abs=1e-4)
            assert made.system.orders == []
            await drive(made, tab)
            await tab.call("Input.dispatchTouchEvent", type="touchCancel", touchPoints=[])
            reason = operator_messages.HIDDEN["pointer"]
            await until(lambda: _is(made.session.reason == reason), "the hold", 10.0)

    run(test())


def test_buttons_are_held_by_a_finger_while_another_moves() -> None:
    async def test() -> None:
        async with opened(touch=True) as (made, tab):
            for selector, order in (("#clutch", Clutch), ("#camera", Camera)):
                at = await middle(tab, selector)

                async def down(o: Any = order, at: Any = at, selector: str = selector) -> bool:
                    await drive(made, tab)  # a busy machine may let go in between
                    await tab.until(f"!document.querySelector('{selector}').disabled", selector)
                    await fingers(tab, "touchStart", at)
                    await asyncio.sleep(0.3)
                    if made.system.last(o)[1] == o(True):
                        return True
                    await fingers(tab, "touchEnd")
                    return False

                await until(down, selector, 40.0)
                await fingers(tab, "touchStart", at, (300, 400))
                before = (await hand(tab))[0]
                await fingers(tab, "touchMove", at, (380, 400))
                assert (await hand(tab))[0] == pytest.approx(before + 0.04, abs=1e-3), selector
                await fingers(tab, "touchEnd")
                await tab.until("!Object.values(surgConsole.hand.latched).includes(true)", "up")
            await drive(made, tab)
            await fingers(tab, "touchStart", await middle(tab, ".jaw"))
            grip = lambda: made.system.last(Move)[1].sample.grip  # noqa: E731
            await until(lambda: _is((grip() or 1) < 0.8), "a closing jaw", 10.0)
            await fingers(tab, "touchEnd")

    run(test())


def test_every_function_has_a_key() -> None:
    async def test() -> None:
        async with opened(touch=False) as (made, tab):
            await tab.tap("KeyZ")
            await tab.until("surgConsole.picture.drawn.at(-1).width === 160", "half the size", 30.0)
            await tab.tap("KeyB")
            await tab.until("surgConsole.picture.drawn.at(-1).width === 320", "both eyes", 30.0)
            assert made.camera.wanted == {("stereo_half", "h264")}
            await tab.tap("KeyJ")
            await tab.until("document.body.dataset.side === 'left'", "the other side")
            panel, view = await middle(tab, "aside"), await middle(tab, "#view")
            assert panel[0] < view[0]
            await drive(made, tab)
            await tab.tap("Equal")
            await until(lambda: _is(SetScale(0.25) in made.system.given(SetScale)), "scale", 10.0)
            await tab.tap("BracketRight")
            assert await tab.run("document.querySelector('#speed-value').innerText") == "25 mm/s"
            await tab.key("Slash", True, "?")
            await tab.key("Slash", False, "?")
            await tab.until("!document.querySelector('#help').hidden", "the help")
            await tab.tap("Escape")
            await until(lambda: _is(made.session.phase is Phase.HELD), "the stop", 10.0)
            await tab.until("document.querySelector('#help').hidden", "the help to go")
            await tab.tap("KeyH")  # nothing is astray: refused
            await tab.until("!document.querySelector('#toast').hidden", "the refusal")
            assert made.system.given(PutBack) == []
            made.session.release(made.session.holder)
            await tab.tap("KeyT")
            await until(lambda: _is(made.session.holder), "control", 10.0)

    run(test())


def test_the_page_fits_every_screen(tmp_path: Path) -> None:
    """The picture, Enable and Stop are on the screen, and what is pressed is large enough."""
    folder = Path(os.environ.get("SURG_SCREEN_SHOTS", tmp_path))
    check = """(() => {
      const seen = (id) => { const b = document.querySelector(id).getBoundingClientRect();
        return b.width > 0 && b.left >= 0 && b.top >= 0
          && b.right <= innerWidth && b.bottom <= innerHeight; };
      const small = [...document.querySelectorAll('button')].filter((b) => b.offsetParent)
        .filter((b) => b.offsetHeight < (matchMedia('(pointer: coarse)').matches ? 44 : 24));
      const ids = ['#view', '#enable', '#stop', '#clutch', '#record'];
      return { unseen: ids.filter((id) => !seen(id)),
        small: small.map((b) => b.id || b.textContent),
        wide: document.documentElement.scrollWidth - innerWidth };
    })()"""

    async def test() -> None:
        async with opened(touch=False) as (made, tab):
            for width, height, touch in SIZES:
                await resize(tab, width, height, touch)
                for side in ("left", "right"):
                    await tab.tap("KeyJ")
                    await asyncio.sleep(0.4)
                    found = await tab.run(check)
                    assert found == {"unseen": [], "small": [], "wide": 0}, (width, side)
                    await tab.screenshot(folder / f"console_{width}_{side}.png")
            assert made.system.orders == []

    run(test())
