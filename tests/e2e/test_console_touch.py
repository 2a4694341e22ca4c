"""The operator's page by fingers, and every function by key, in Chromium."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.async_tests import within
from helpers.teleop import chromium
from helpers.teleop.chromium import Tab, until
from helpers.teleop.console import Console, drive, opened
from helpers.teleop.console_page import when
from surg_console.session import operator_messages
from surg_console.session.console_orders import (
    Camera,
    Clutch,
    GuideHome,
    Move,
    Policy,
    Record,
    SetScale,
)
from surg_console.session.console_session import Phase
from surg_console.session.system_state import PolicyServer

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]

SIZES = ((1366, 768, False), (1024, 768, True), (390, 844, True))
"""Screens: width, height [px], and whether they are touched."""
TABLET = SIZES[1]


async def hand(tab: Tab) -> np.ndarray:
    """Where the handle is, once it stands still: x, y, z [m], roll [rad]."""
    await asyncio.sleep(0.3)
    await tab.until("Math.abs(surgConsole.hand.goal.x - surgConsole.hand.now.x) < 1e-5", "rest")
    return np.array(await tab.run("Object.values(surgConsole.hand.goal)"))


@within(240.0)
async def test_one_finger_moves_in_the_picture_and_two_along_and_about_it() -> None:
    async with opened(screen=TABLET) as (made, _, tab):
        before = await hand(tab)
        await tab.fingers("touchStart", (300, 400))
        for step in range(1, 6):
            await tab.fingers("touchMove", (300 + 10 * step, 400 - 6 * step))
        after = await hand(tab)
        assert after - before == pytest.approx([0.025, -0.015, 0, 0], abs=1e-3)
        # A second finger: both up is deeper.
        await tab.fingers("touchStart", (350, 370), (450, 370))
        for step in range(1, 6):
            await tab.fingers("touchMove", (350, 370 - 8 * step), (450, 370 - 8 * step))
        deeper = await hand(tab)
        assert deeper - after == pytest.approx([0, 0, 0.02, 0], abs=1e-3)
        # Turned clockwise about their middle: roll about the view's z, which points away.
        for step in range(1, 11):
            c, s = (50 * f(0.05 * step) for f in (math.cos, math.sin))
            await tab.fingers("touchMove", (400 - c, 330 - s), (400 + c, 330 + s))
        turned = await hand(tab)
        assert turned[3] - deeper[3] == pytest.approx(0.5, abs=0.03)
        assert turned[:3] == pytest.approx(deeper[:3], abs=1e-3)
        # One is lifted: what the other does until it is lifted too moves nothing.
        await tab.fingers("touchEnd", (400, 330))
        await tab.fingers("touchMove", (300, 300))
        assert await hand(tab) == pytest.approx(turned, abs=1e-4)
        assert made.system.orders == []
        await drive(made, tab)
        await tab.fingers("touchCancel")
        reason = operator_messages.HIDDEN["pointer"]
        await when(lambda: made.session.reason == reason, "the hold", 10.0)


@within(240.0)
async def test_buttons_are_held_by_a_finger_while_another_moves() -> None:
    async with opened(screen=TABLET) as (made, _, tab):
        for selector, order in (("#clutch", Clutch), ("#camera", Camera)):
            at = await tab.middle(selector)

            async def down(o: Any = order, at: Any = at, selector: str = selector) -> bool:
                await drive(made, tab)  # a busy machine may let go in between
                await tab.until(f"!document.querySelector('{selector}').disabled", selector)
                await tab.fingers("touchStart", at)
                await asyncio.sleep(0.3)
                if made.system.last(o)[1] == o(True):
                    return True
                await tab.fingers("touchEnd")
                return False

            await until(down, selector, 40.0)
            await tab.fingers("touchStart", at, (300, 400))
            before = (await hand(tab))[0]
            await tab.fingers("touchMove", at, (380, 400))
            assert (await hand(tab))[0] == pytest.approx(before + 0.04, abs=1e-3), selector
            await tab.fingers("touchEnd")
            await tab.until("!Object.values(surgConsole.hand.latched).includes(true)", "up")
        await drive(made, tab)
        await tab.fingers("touchStart", await tab.middle(".jaw"))
        grip = lambda: made.system.last(Move)[1].sample.grip  # noqa: E731
        await when(lambda: (grip() or 1) < 0.8, "a closing jaw", 10.0)
        await tab.fingers("touchEnd")


def drawn_wide(width: int) -> str:
    return f"surgConsole.picture.drawn.at(-1).width === {width}"


def pressed(selector: str) -> str:
    return f"document.querySelector('{selector}').getAttribute('aria-pressed') === 'true'"


AXES: dict[str, tuple[str, int, int]] = {
    **dict.fromkeys(("A", "←"), ("v", 0, -1)), **dict.fromkeys(("D", "→"), ("v", 0, 1)),
    **dict.fromkeys(("W", "↑"), ("v", 1, -1)), **dict.fromkeys(("S", "↓"), ("v", 1, 1)),
    **dict.fromkeys(("F", "Page down"), ("v", 2, -1)),
    **dict.fromkeys(("R", "Page up"), ("v", 2, 1)),
    **dict.fromkeys(("Q", "Home"), ("roll_rate", 0, -1)),
    **dict.fromkeys(("E", "End"), ("roll_rate", 0, 1)),
    "7": ("tilt", 1, -1), "8": ("tilt", 0, 1), "9": ("tilt", 0, -1), "0": ("tilt", 1, 1),
}  # fmt: skip
"""Motion keys by the help's words: field of the sample, axis (x right, y down, z away), sign."""
JAW = {"K": -1, "L": 1, "Delete": -1, "Insert": 1}
OF_THE_PAGE = {
    "Z": drawn_wide(160),
    "B": drawn_wide(320),
    "J": "document.body.dataset.side === 'left'",
    "N": pressed('[data-overlay="marks"]'),
    "I": pressed('[data-overlay="plan"]'),
    "O": pressed('[data-overlay="scene"]'),
    "Y": pressed("#feel"),
    "M": "surgConsole.hand.hand === 'rate'",
    "]": "document.querySelector('#speed-value').innerText === '25 mm/s'",
    "[": "document.querySelector('#speed-value').innerText === '20 mm/s'",
}
"""Keys that change the page alone, in the order of the test, and what is true then."""
CODES = {
    "←": "ArrowLeft", "→": "ArrowRight", "↑": "ArrowUp", "↓": "ArrowDown", "Page up": "PageUp",
    "Page down": "PageDown", "−": "Minus", "=": "Equal", "[": "BracketLeft", "]": "BracketRight",
    "Esc": "Escape", "Shift": "ShiftLeft", **{digit: f"Digit{digit}" for digit in "1237890"},
}  # fmt: skip
"""Words of the help -> codes of the browser; a letter X is KeyX, others are as they are called."""


class Keyboard:
    """Presses keys by the words of the help, and remembers which."""

    def __init__(self, tab: Tab) -> None:
        self._tab = tab
        self.tried: set[str] = set()

    async def tap(self, label: str) -> None:
        async with self.held(label):
            pass

    @contextlib.asynccontextmanager
    async def held(self, label: str) -> AsyncIterator[None]:
        self.tried.add(label)
        code = CODES.get(label, f"Key{label}" if label.isalpha() and len(label) == 1 else label)
        key = ("Slash", "?") if label == "?" else (code, code)
        await self._tab.key(key[0], True, key[1])
        try:
            yield
        finally:
            await self._tab.key(key[0], False, key[1])


@within(240.0)
async def test_every_key_of_the_help_does_what_it_says() -> None:
    async with opened(screen=SIZES[0]) as (made, _, tab):
        keys = Keyboard(tab)
        made.system.now = replace(made.system.now, policy=PolicyServer("READY"))  # for I and P
        await tab.until("!document.querySelector('#policy').hidden", "a model server", 10.0)
        await own_keys(tab, keys)
        await motion_keys(made, tab, keys)
        await session_keys(made, tab, keys)
        words = "[...document.querySelectorAll('#help-keys kbd')].map((k) => k.textContent)"
        shown = set(await tab.run(words)) - {"Drag"}  # the mouse: test_console_page.py
        assert shown == keys.tried, "each key of the help was tried, and no other"


async def own_keys(tab: Tab, keys: Keyboard) -> None:
    """Of the page alone."""
    for label, true in OF_THE_PAGE.items():
        assert not await tab.run(true), label
        await keys.tap(label)
        await tab.until(true, label, 30.0)
    panel, view = await tab.middle("aside"), await tab.middle("#view")
    assert panel[0] < view[0]
    for hidden in ("!", ""):
        await keys.tap("?")
        await tab.until(f"{hidden}document.querySelector('#help').hidden", "the help")


async def motion_keys(made: Console, tab: Tab, keys: Keyboard) -> None:
    """Of the hand, while it drives; a busy machine may let go in between."""

    def sample() -> Any:
        return made.system.last(Move)[1].sample

    for label, (field, axis, sign) in AXES.items():
        await drive(made, tab)
        async with keys.held(label):
            rate = lambda f=field, k=axis: np.atleast_1d(getattr(sample(), f))[k]  # noqa: E731
            await when(lambda r=rate, s=sign: s * r() > 0.0, label, 20.0)
    for label, sign in JAW.items():
        await drive(made, tab)
        before = 1.0 if sample().grip is None else sample().grip
        async with keys.held(label):
            went = lambda b=before, s=sign: s * ((sample().grip or b) - b) > 0.05  # noqa: E731
            await when(lambda w=went: w(), label, 20.0)
    for label, order in (("Space", Clutch), ("C", Camera)):
        for held in (True, False):
            await drive(made, tab)
            async with keys.held(label) if held else contextlib.nullcontext():
                is_held = lambda o=order, h=held: made.system.last(o)[1] == o(h)  # noqa: E731
                await when(lambda i=is_held: i(), label, 20.0)
    await drive(made, tab)
    async with keys.held("D"):
        await when(lambda: sample().v[0] > 0.019, "full speed", 20.0)
        async with keys.held("Shift"):
            await when(lambda: 0.0 < sample().v[0] < 0.006, "a quarter of it", 20.0)


async def session_keys(made: Console, tab: Tab, keys: Keyboard) -> None:
    """Of recorder, policy, scale and the arm."""

    async def refused(label: str) -> None:
        await tab.run("document.querySelector('#toast').hidden = true")
        await keys.tap(label)
        await tab.until("!document.querySelector('#toast').hidden", f"why {label} is refused")

    given = made.system.given
    await drive(made, tab)
    for label, scale in (("=", 0.25), ("−", 0.2)):
        await keys.tap(label)
        await when(lambda v=scale: SetScale(v) in given(SetScale), label, 10.0)
    await keys.tap("V")
    await when(lambda: Record(True) in given(Record), "the recorder", 10.0)
    for label in ("G", "1", "2", "3", "H"):  # no task, no recording, no arm in FAULT
        await refused(label)
    assert given(GuideHome) == []
    await keys.tap("P")
    await when(lambda: Policy(True) in given(Policy), "the policy", 10.0)
    made.session.release(made.session.holder)
    await keys.tap("T")
    await when(lambda: made.session.holder, "control", 10.0)
    await keys.tap("Enter")
    await drive(made, tab)
    await keys.tap("?")
    await keys.tap("Esc")
    await when(lambda: made.session.phase is Phase.HELD, "the stop", 10.0)
    await tab.until("document.querySelector('#help').hidden", "the help to go")


@within(240.0)
async def test_the_page_fits_every_screen(tmp_path: Path) -> None:
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
    async with opened(screen=SIZES[0]) as (made, _, tab):
        for width, height, touch in SIZES:
            await tab.resize(width, height, touch)
            for side in ("left", "right"):
                await tab.tap("KeyJ")
                await asyncio.sleep(0.4)
                found = await tab.run(check)
                assert found == {"unseen": [], "small": [], "wide": 0}, (width, side)
                await tab.screenshot(folder / f"console_{width}_{side}.png")
        assert made.system.orders == []
