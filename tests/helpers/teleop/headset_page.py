"""The page /headset with a headset that is not there: how a test wears it, and what it must do."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import replace

import numpy as np
import pytest

from helpers.teleop.chromium import Chromium, Tab, until
from helpers.teleop.console import Console, console
from helpers.teleop.console import drive as drive_page
from helpers.teleop.console_page import when
from helpers.teleop.headset import FAKE_XR
from surg_console.session.console_orders import Camera, Clutch, Move, Record
from surg_console.session.console_session import Phase

TRIGGER, SQUEEZE, A, B = 0, 1, 4, 5
LEFT, RIGHT = (200, 60, 60), (40, 60, 200)


async def holds(made: Console) -> bool:
    """Whether nothing drives."""
    return made.session.phase is not Phase.DRIVING


async def hold(tab: Tab, hand: str, button: int, value: float) -> None:
    """Press a button of a controller."""
    await tab.run(f"fakeXR.hold('{hand}', {button}, {value})")


@contextlib.asynccontextmanager
async def entered(head: str = "", before: str = FAKE_XR) -> AsyncIterator[tuple[Console, Tab]]:
    """A page whose headset is on, with pictures."""
    async with console() as made, Chromium((900, 700)) as browser:
        made.camera.eyes = tuple(np.full((240, 320, 3), c, np.uint8) for c in (LEFT, RIGHT))
        tab = await browser.open(f"{made.url}headset", before)
        await tab.until("!document.querySelector('#enter').disabled", "the headset", 30.0)
        if head:
            await tab.run(f"fakeXR.head.q = {head}, 0")
        await tab.click("#enter")
        await tab.until("surgHeadset.picture.drawn.length > 2", "pictures", 60.0)
        yield made, tab
        assert browser.errors == []


async def drive(made: Console, tab: Tab) -> None:
    """A is pressed until the session drives."""

    async def enable() -> None:
        for value in (1, 0):
            await hold(tab, "right", A, value)
            await asyncio.sleep(0.1)

    await drive_page(made, tab, enable)


async def squeezed(made: Console, tab: Tab, hand: str = "right") -> None:
    """A squeeze that counts, and has settled."""

    async def counts() -> bool:
        await drive(made, tab)
        for other in ("left", "right"):  # after a hold all must be let go
            await hold(tab, other, SQUEEZE, 0)
        for value in (0, 1):
            await hold(tab, hand, SQUEEZE, value)
            await asyncio.sleep(0.3)
        dead_man = made.session._pages[made.session.holder].dead_man
        return dead_man is not None and dead_man.engaged

    await until(counts, f"the {hand} squeeze", 60.0)


async def came(made: Console, tab: Tab, hand: str, by: tuple[float, float, float]) -> np.ndarray:
    """How far the handle comes when a hand moves in the room, (3,) [m]."""
    for _ in range(5):  # a busy machine may let go in between
        await squeezed(made, tab, hand)
        before = made.system.last(Move)[1].sample
        await tab.run(f"fakeXR.move('{hand}', {list(by)})")
        await asyncio.sleep(0.3)
        after = made.system.last(Move)[1].sample
        if made.session.phase is Phase.DRIVING:
            assert after.camera == (hand == "left") and not after.clutch
            return np.array(after.p) - np.array(before.p)
    raise AssertionError("the arm was never driven for 0.3 s")


async def drives(made: Console, tab: Tab, pulses: bool = True) -> None:
    """Each eye its picture, dead-man, directions, jaw, endoscope, pulse, stop."""
    assert made.session.holder
    await tab.run("fakeXR.wantPixels = true, 0")

    async def own() -> bool:
        eyes = await tab.run("fakeXR.pixels")
        wanted = np.array([LEFT, RIGHT])
        return bool(eyes) and np.abs(np.array(eyes)[:, :3] - wanted).max() < 16

    await until(own, "each eye its own picture", 20.0)
    await tab.run("fakeXR.wantPixels = false, 0")

    await drive(made, tab)
    still = made.system.last(Move)[1].sample
    await tab.run("fakeXR.move('right', [0.1, 0.1, 0.1])")
    await asyncio.sleep(0.4)
    sample = made.system.last(Move)[1].sample
    assert sample.p == still.p and sample.q == still.q and sample.clutch, "no squeeze"
    assert made.system.last(Clutch)[1] == Clutch(True)

    right, up, away = (0.05, 0, 0), (0, 0.05, 0), (0, 0, -0.05)
    for by, seen in ((right, (0.05, 0, 0)), (up, (0, -0.05, 0)), (away, (0, 0, 0.05))):
        assert await came(made, tab, "right", by) == pytest.approx(seen, abs=1e-4)
    assert await came(made, tab, "left", right) == pytest.approx((0.05, 0, 0), abs=1e-4)
    assert made.system.last(Camera)[1] == Camera(True)
    await hold(tab, "left", SQUEEZE, 0)

    await squeezed(made, tab)
    assert made.system.last(Move)[1].sample.grip is None, "the trigger was never touched"
    await hold(tab, "right", TRIGGER, 0.75)
    await when(lambda: made.system.last(Move)[1].sample.grip == 0.25, "the jaw", 10.0)

    follower = replace(made.system.now.follower, at_wall=True)
    made.system.now = replace(made.system.now, follower=follower)
    if pulses:
        await tab.until("fakeXR.right.pulses > 1", "pulses at the wall", 20.0)
    await hold(tab, "left", A, 1)
    await when(lambda: Record(True) in made.system.given(Record), "the recording", 10.0)
    await hold(tab, "right", B, 1)
    await when(lambda: "Stop was pressed" in made.session.reason, "the stop", 10.0)
