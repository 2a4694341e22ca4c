"""Gamepads that the browser does not know: nothing until a person has mapped them."""

from __future__ import annotations

import asyncio
import json

import pytest

from helpers.async_tests import within
from helpers.teleop.chromium import GAMEPAD, Chromium, Tab, missing
from helpers.teleop.console import console
from helpers.teleop.pad_layouts import LAYOUTS, TRIAL
from surg_console.session import operator_messages
from surg_console.session.console_session import Phase

pytestmark = pytest.mark.skipif(bool(missing()), reason=missing())
SIGN = {"x": 1, "y": 1, "z": 1, "roll": 1, "close": -1, "open": 1}
NOTHING = {"x": 0, "y": 0, "z": 0, "roll": 0, "grip": 0, "held": [], "pressed": []}


@within(120.0)
async def test_every_layout_rests_and_moves_as_it_was_mapped() -> None:
    async with console() as made, Chromium() as browser:
        tab = await browser.open(made.url, GAMEPAD)
        await tab.until("document.querySelector('#pad-map') !== null", "the page")
        for name, layout in LAYOUTS.items():
            out = await tab.run(f"({TRIAL})({json.dumps(layout.document())})")
            print(name, out)
            assert out["still"], name
            assert out["untouched"], name
            assert out["stages"] == {}, name
            assert out.get("unheld", 0) == 0, name
            for control, did in out["did"].items():
                wish = {key: did[key] for key in ("x", "y", "z", "roll", "grip")}
                held = set(did["held"]) - {"hold"}
                if control in SIGN:
                    moved = "grip" if control in ("open", "close") else control
                    assert wish.pop(moved) == pytest.approx(SIGN[control]), (name, control)
                    assert not held and not did["pressed"], (name, control)
                else:
                    assert held == {control} and did["pressed"] == [control], (name, control)
                assert not any(wish.values()), (name, control, did)
            assert out["lost"] == 1, name
            assert out["back"] == NOTHING, name
        assert browser.errors == []


async def put(tab: Tab, axes: list[float], button: int = 99) -> None:
    await tab.run(f"plug({axes}, {{{button}: 1}}); window.pad.mapping = ''; 0")


async def learn(tab: Tab, axes: list[float], button: int = 99) -> None:
    """Move one control once, and wait for the next step."""
    step = "(surgConsole.hand.pads.lesson?.step ?? 99)"
    before = await tab.run(step)
    await asyncio.sleep(0.5)
    await put(tab, axes, button)
    await asyncio.sleep(0.5)
    await put(tab, [0, 0, -1, 0])
    await tab.until(f"{step} > {before}", "the next step")


@within(180.0)
async def test_a_person_maps_a_pad_and_the_page_remembers_it() -> None:
    async with console() as made, Chromium() as browser:
        tab = await browser.open(made.url, GAMEPAD)
        await tab.until("surgConsole.picture.drawn.length > 3", "pictures", 60.0)
        await put(tab, [0, 0, -1, 0])
        await tab.until("!document.querySelector('#pad-map').hidden", "the button")
        await tab.click("#pad-map")
        await tab.until("document.querySelector('#pad-sentence').innerText !== ''", "a sentence")
        await learn(tab, [1, 0, -1, 0])
        await learn(tab, [0, 1, -1, 0])
        await learn(tab, [0, 0, 1, 0])
        for _ in range(4):  # roll, jaw, dead-man
            await tab.click("#pad-skip")
        await learn(tab, [0, 0, -1, 0], 3)  # the clutch
        await tab.click("#pad-skip")
        await learn(tab, [0, 0, -1, 0], 0)  # enable
        await tab.click("#pad-skip")
        await tab.click("#pad-skip")
        await tab.until("document.querySelector('#pad-lesson').hidden", "the end")

        await tab.run("location.reload(); 0")
        await tab.until("globalThis.surgConsole?.picture.drawn.length > 3", "pictures", 60.0)
        await put(tab, [0, 0, -1, 0])
        for _ in range(20):  # on a busy machine a gap may let go at once
            await asyncio.sleep(0.5)
            if made.session.phase is Phase.DRIVING:
                break
            await put(tab, [0, 0, -1, 0], 0)
            await asyncio.sleep(0.2)
            await put(tab, [0, 0, -1, 0])
        assert made.session.phase is Phase.DRIVING
        await put(tab, [0, 0, -1, 0], 3)
        await tab.until("surgConsole.hand.held('clutch')", "the clutch")
        await put(tab, [0, 0, 0.9, 0], 3)
        await tab.until("surgConsole.hand.sample(0.02).v[2] > 0.001", "deeper")
        await tab.run("window.pad = null; 0")  # with its lever deflected
        await tab.until("surgConsole.status()?.phase !== 'driving'", "the hold")
        assert made.session.phase is Phase.HELD
        assert made.session.reason == operator_messages.HIDDEN["gamepad"]
