"""The operator's page in Chromium, before a console whose robot a test holds in its hands."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from helpers.async_tests import within
from helpers.results.console_results import keeps, note
from helpers.teleop import chromium
from helpers.teleop.chromium import GAMEPAD, Chromium, Tab, until
from helpers.teleop.console import Console, console, drive, opened
from helpers.teleop.console_page import when
from surg_console.session import operator_messages
from surg_console.session.console_orders import (
    Camera,
    Clutch,
    EnableTeleop,
    Move,
    Record,
    SetOperatorPresent,
    SetScale,
)
from surg_console.session.console_session import Phase
from surg_console.session.fixture_view import FixtureView
from surg_console.session.system_state import Drift
from surg_core import Fixture

pytestmark = pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing())

ROUNDS = 20
LATEST = 0.3
"""[s] between the last input that went out and the order to hold."""


async def moved(made: Console, tab: Tab, what: str, wanted: Any, key: str = "") -> Move:
    """Wait for an input that fits, driving again when a busy machine made the console let go.

    A key that was held is forgotten then, and pressed anew.
    """
    start = len(made.system.orders)

    async def found() -> Move | None:
        fitting = (
            o for _, o in made.system.orders[start:] if isinstance(o, Move) and wanted(o.sample)
        )
        fits = next(fitting, None)
        if fits is None and made.session.phase is not Phase.DRIVING:
            await drive(made, tab)
            if key:
                await tab.key(key, False)
                await tab.key(key, True)
        return fits

    return await until(found, what, 40.0)


async def picture(tab: Tab) -> np.ndarray:
    """The pixels in the middle of the picture, as they are on the screen."""
    x, y = map(round, await tab.middle("#picture"))
    return (await tab.pixels())[y - 60 : y + 60, x - 150 : x + 150]


async def live(made: Console, browser: Chromium, tab: Tab) -> None:
    """One life: enable, keys, gamepad, clutch, mouse, record, stop."""
    system = made.system
    assert await tab.run("crossOriginIsolated")
    await drive(made, tab)
    assert EnableTeleop(True) in system.given(EnableTeleop)

    # Keys are a rate in the picture; D and R together are right and away.
    await tab.key("Space", True)
    await when(lambda: Clutch(True) in system.given(Clutch), "the clutch", 20.0)
    await tab.key("KeyD", True)
    await tab.key("KeyR", True)
    sample = (await moved(made, tab, "keys", lambda s: s.v[0] > 0.001 and s.v[2] > 0.001)).sample
    assert sample.hand == "rate" and sample.v[0] == pytest.approx(sample.v[2])
    assert np.linalg.norm(sample.v) == pytest.approx(0.02) and sample.v[1] == 0
    await tab.key("KeyD", False)
    await tab.key("KeyR", False)
    await tab.key("Space", False)
    await moved(made, tab, "rest", lambda s: s.v == (0, 0, 0) and not s.clutch)
    await tab.key("KeyK", True)
    await moved(
        made, tab, "a closing jaw", lambda s: s.grip is not None and s.grip < 0.8, key="KeyK"
    )
    await tab.key("KeyK", False)

    # A gamepad: left stick up is up in the picture (-y), triggers close and open the jaw. It is
    # the one that is touched, not one that lies beside it.
    await tab.run(
        "window.idle = {id: 'idle', index: 1, connected: true, mapping: 'standard',"
        " axes: [0, 0.1, 0, 0], buttons: []}; 0"
    )
    await tab.run("window.plug([0, 0, 0, 0], {}); 0")
    await tab.until("surgConsole.hand.pads.seen.size === 2", "both pads")
    await tab.run("window.plug([0, -1, 0, 0], {})")
    sample = (await moved(made, tab, "the stick", lambda s: s.v[1] < -0.001)).sample
    assert sample.v[1] == pytest.approx(-0.02) and sample.v[0] == 0
    await tab.run("window.plug([0.1, 0.1, 1, 0], {4: 1})")  # dead zone; roll; clutch
    sample = (await moved(made, tab, "roll", lambda s: s.roll_rate > 1.0 and s.clutch)).sample
    assert sample.v == (0, 0, 0)
    await tab.run("window.plug([0, 0, 0, 0], {7: 1})")
    await moved(made, tab, "a closed jaw", lambda s: s.grip == 0.0)

    # Unplugging it holds the arm.
    await tab.run("window.pad = null; 0")
    await when(lambda: "gamepad was unplugged" in made.session.reason, "the hold", 20.0)
    await drive(made, tab)

    # The mouse is a position: under the clutch the hand changes, then a drag moves it.
    await tab.key("Space", True)
    await moved(made, tab, "the clutch", lambda s: s.clutch, key="Space")
    await tab.mouse("mousePressed", 400, 400, button="left", clickCount=1)
    await moved(made, tab, "the mouse", lambda s: s.hand == "position")
    await tab.key("Space", False)
    before = (await moved(made, tab, "rest", lambda s: not s.clutch)).sample.p
    for step in range(1, 6):
        await tab.mouse("mouseMoved", 400 + 20 * step, 400 - 10 * step, button="left", buttons=1)
    await moved(made, tab, "the drag", lambda s: s.p[0] > before[0] + 0.045)
    sample = system.last(Move)[1].sample
    assert sample.p[1] < before[1] - 0.02 and sample.p[2] == before[2]
    await tab.mouse("mouseReleased", 500, 350, button="left", clickCount=1)
    await tab.mouse("mouseWheel", 500, 350, deltaX=0, deltaY=-100)
    await moved(made, tab, "the wheel", lambda s: s.p[2] > before[2] + 0.003)

    # Buttons.
    await tab.click("#camera")
    await when(lambda: Camera(True) in system.given(Camera), "the camera", 20.0)
    await tab.click("#record")
    await when(lambda: Record(True) in system.given(Record), "the recording", 20.0)
    await tab.run(
        "(() => { const s = document.querySelector('#scale'); s.value = 0.5;"
        " s.dispatchEvent(new Event('input')) })()"
    )
    await when(lambda: SetScale(0.5) in system.given(SetScale), "the scale", 20.0)
    await tab.tap("Escape")
    await when(lambda: made.session.phase is Phase.HELD, "the stop", 20.0)
    assert system.last(SetOperatorPresent)[1] == SetOperatorPresent(False)
    await tab.until("!document.querySelector('#veil').hidden", "the veil")
    assert "Stop was pressed" in await tab.run("document.querySelector('#veil-sentence').innerText")


@within(240.0)
async def test_the_page_drives_an_arm_by_keys_gamepad_and_mouse() -> None:
    async with opened(GAMEPAD) as (made, browser, tab):
        await live(made, browser, tab)
        await tab.click('#eyes [data-layout="stereo"]')
        await tab.until("surgConsole.picture.drawn.at(-1).width === 640", "two eyes", 40.0)
        assert set(made.camera.wanted) == {("stereo", "h264")}
        other = await browser.open(made.url)
        await other.until("document.querySelector('#headline').innerText === 'Watching'", "it")
        assert await other.run("document.querySelector('#enable').disabled")
        assert not await other.run("document.querySelector('#stop').disabled")


BUSY = """(() => {
  globalThis.busy = setInterval(() => {
    const until = performance.now() + 70;
    while (performance.now() < until);
  }, 90);
})()"""


@within(240.0)
async def test_a_page_that_is_late_with_its_inputs_takes_fewer_pictures_and_says_so() -> None:
    stream = ("left", "h264")
    async with opened(GAMEPAD) as (made, _, tab):
        rate = "document.querySelector('#rate').innerText"
        assert made.camera.wanted == {stream: 0} and "fewer" not in await tab.run(rate)
        await tab.run(BUSY)

        async def fewest() -> bool:
            await drive(made, tab)
            return made.camera.wanted.get(stream) == 200

        await until(fewest, "fewer pictures", 60.0)
        await tab.run("clearInterval(globalThis.busy)")
        await tab.until(f"{rate}.endsWith('fewer, inputs go first')", "the sentence")
        began = await tab.run("surgConsole.picture.drawn.length")
        await asyncio.sleep(3.0)
        drawn = await tab.run("surgConsole.picture.drawn.length") - began
        assert 3 <= drawn <= 25, "of the 60 that there were"

        async def all_again() -> bool:
            await drive(made, tab)
            await tab.run("(surgConsole.pace.calm = 19.9, 0)")  # as after a calm while
            return made.camera.wanted.get(stream) == 0

        await until(all_again, "all pictures", 60.0, 0.3)
        await tab.until(f"!{rate}.includes('fewer')", "the sentence's end")


async def lose_the_focus(made: Console, tab: Tab) -> None:
    """As by a dialog or Alt+Tab: the page is still seen, but keys that go up are not heard."""
    before = len(made.system.orders)
    await tab.run("dispatchEvent(new Event('blur')); 0")
    await when(lambda: made.session.phase is Phase.HELD, "the hold", 20.0)
    assert made.session.reason == operator_messages.HIDDEN["pointer"]
    orders = [order for _, order in made.system.orders[before:]]
    assert Clutch(False) not in orders and Camera(False) not in orders


@within(240.0)
async def test_a_lost_focus_holds_the_arm_and_engages_nothing() -> None:
    async with opened(GAMEPAD) as (made, _, tab):
        for code in ("Space", "KeyC"):
            await drive(made, tab)
            await tab.key(code, True)
            await moved(made, tab, code, lambda s: s.clutch or s.camera, key=code)
            await lose_the_focus(made, tab)
            await tab.key(code, False)
        await drive(made, tab)
        await tab.mouse("mousePressed", 400, 400, button="left", clickCount=1)
        await tab.mouse("mouseMoved", 420, 400, button="left", buttons=1)
        before = (await moved(made, tab, "the drag", lambda s: s.p[0] > 0.005)).sample.p
        await lose_the_focus(made, tab)
        await drive(made, tab)
        await tab.mouse("mouseMoved", 500, 400, button="left", buttons=1)
        await asyncio.sleep(0.3)
        assert made.system.last(Move)[1].sample.p[0] < before[0] + 0.006
        await drive(made, tab)  # with no hand on anything the focus may go
        await tab.mouse("mouseReleased", 500, 400, button="left", clickCount=1)
        await tab.run("dispatchEvent(new Event('blur')); 0")
        await asyncio.sleep(0.3)
        assert "was lost" not in made.session.reason


@within(240.0)
async def test_a_lost_connection_lets_latched_buttons_go() -> None:
    async with opened(GAMEPAD) as (made, _, tab):
        await drive(made, tab)
        await tab.click("#camera")
        await when(lambda: Camera(True) in made.system.given(Camera), "the camera", 20.0)
        await tab.run("surgConsole.link.socket.close(); 0")
        await when(lambda: made.session.phase is Phase.FREE, "the end", 20.0)
        before = len(made.system.orders)
        await drive(made, tab)
        await asyncio.sleep(0.3)
        assert Camera(True) not in [order for _, order in made.system.orders[before:]]


@within(240.0)
async def test_the_picture_is_the_one_that_was_sent_and_a_lost_console_is_named() -> None:
    """The moving bar is seen where it was drawn, in its colours, by either codec."""
    async with Chromium() as browser:
        async with console() as made:
            for codec in ("h264", "jpeg"):
                made.camera.running = True
                tab = await browser.open(f"{made.url}?codec={codec}")
                await tab.until("surgConsole.picture.drawn.length > 3", "pictures", 60.0)
                assert await tab.run("surgConsole.picture.drawn.at(-1).codec") == codec
                made.camera.running = False
                await asyncio.sleep(0.8)
                pixels = (await picture(tab)).reshape(-1, 3)
                grey = np.abs(pixels - np.array([60, 60, 60])).max(axis=1) < 12
                green = np.abs(pixels - np.array([40, 200, 90])).max(axis=1) < 25
                seen = (codec, grey.mean(), green.mean())
                assert grey.mean() > 0.5 and (grey | green).mean() > 0.9, seen
        assert browser.errors == []
        headline = "document.querySelector('#headline').innerText"
        await tab.until(f"{headline} === 'No connection'", "words")
        text = await tab.run("document.querySelector('#sentence').innerText")
        assert "Start it again in its terminal: ./surg teleop test_cell." in text


@within(240.0)
async def test_the_page_shows_clearance_and_virtual_fixtures() -> None:
    up = np.array([0.0, 0.0, 1.0])
    floor = Fixture("floor", "plane", "stay_in", "tip", np.zeros(3), up, 0.0)
    vessel = Fixture("vessel", "sphere", "keep_out", "tip", np.array([0.03, 0, 0.02]), up, 0.01)
    X_BR = np.diag([1.0, -1.0, -1.0, 1.0])
    X_BR[2, 3] = 0.1
    async with opened(GAMEPAD) as (made, _, tab):
        assert await tab.run("document.querySelector('#fixtures-card').hidden")
        fixtures = FixtureView((floor, vessel), np.array([0.0, 0.0, 0.004]), X_BR)
        for clearance, tone in ((0.1, "good"), (0.03, "warn"), (0.015, "bad")):
            gauges = replace(made.system.now.gauges, clearance=clearance)
            made.system.now = replace(made.system.now, gauges=gauges, fixtures=fixtures)
            node = "document.querySelector('#clearance')"
            shown = f"{node}.querySelector('b').innerText === '{clearance * 1e3:.0f}'"
            await tab.until(shown, tone, 20.0)
            assert await tab.run(f"{node}.dataset.tone") == tone
        drift = "document.querySelector('#drift')"
        assert await tab.run(f"{drift}.hidden")
        moved = Drift("moved", 0.0021, 0.0034, 0.0047, "it moved")
        watched = (
            (Drift("steady", 0.0001, 0.0004, 0.0007), "good", "0.4mm0.1to0.7,95%"),
            (Drift("cannot tell: dark", None), "good", "–mmcannottell:dark"),
            (moved, "bad", "3.4mm2.1to4.7,95%itmoved"),
        )
        for said, tone, words in watched:
            made.system.now = replace(made.system.now, drift=said)
            shown = f"{drift}.textContent.replace(/\\s/g, '').includes('{words}')"
            await tab.until(shown, words, 20.0)
            assert await tab.run(f"{drift}.dataset.tone") == tone
        rows = await tab.run("document.querySelector('#fixtures-list').innerText")
        assert "floor" in rows and "stay in: 4.0 mm" in rows
        away = np.hypot(0.03, 0.016) - 0.01
        assert f"keep out: {away * 1e3:.1f} mm" in rows
        # The sphere's middle and the shaft, by their colours.
        sphere, shaft = await tab.run(
            "(() => { const c = document.querySelector('#fixtures');"
            " const scale = Math.min(c.width / 4 / 0.09, (c.height - 12) / 0.24);"
            " const at = (x, z) => [...c.getContext('2d').getImageData("
            "c.width / 4 + scale * x, 10 + scale * z, 1, 1).data];"
            " return [at(0.03, 0.08), at(0, 0.05)] })()"
        )
        assert sphere[0] > 2 * sphere[2] and sphere[3] > 100, sphere
        assert min(shaft[:3]) > 150, shaft


FREEZE = "(() => { const t = performance.now(); while (performance.now() < t + 1200); })()"
STOPS = {
    "hidden": lambda browser, tab: browser.open("about:blank", ready=False),
    "frozen": lambda browser, tab: tab.call("Runtime.evaluate", expression=FREEZE),
    "closed": lambda browser, tab: tab.close(),
}
"""What happens to the tab of the operator."""


@pytest.mark.full  # in every run test_console_server.py does the same without a browser
@within(240.0)
async def test_a_tab_that_goes_holds_the_arm() -> None:
    found: dict[str, list[float]] = {what: [] for what in STOPS}
    async with console() as made, Chromium() as browser:
        for _ in range(ROUNDS):
            for what, stop in STOPS.items():
                tab = await browser.open(made.url)
                await tab.until("surgConsole.picture.drawn.length > 3", "pictures", 60.0)
                await drive(made, tab)
                began = time.monotonic()
                doing = asyncio.create_task(stop(browser, tab))
                await when(lambda: made.session.phase is not Phase.DRIVING, what, 20.0)
                at, order = made.system.last(SetOperatorPresent)
                assert order == SetOperatorPresent(False)
                assert at - made.system.last(Move)[0] < LATEST, what
                found[what].append(at - began)
                await doing
                await asyncio.sleep(0.2)  # whatever is still under way
                assert made.system.last(Move)[0] <= at, what
                if what != "closed":
                    await tab.close()
                await when(lambda: made.session.pages == 0, "an empty console", 20.0)
    for what, seconds in found.items():
        note(f"tab {what}", len(seconds), seconds)
        keeps(f"tab {what}", seconds, 0.3 if what == "frozen" else 0.2)
