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


EIGHT = {-1: (0, -1), -5 / 7: (1, -1), -3 / 7: (1, 0), -1 / 7: (1, 1)} | {
    1 / 7: (0, 1),
    3 / 7: (-1, 1),
    5 / 7: (-1, 0),
    1: (-1, -1),
}
"""What a hat's one axis says, clockwise from up -> right and down, as a person pushed it."""
HELD_HAT = """
(async (rest, values) => {
  const { Lesson } = await import("/page/pads/lesson.js");
  const { Pads } = await import("/page/pads/pads.js");
  const pad = { id: "hat", index: 5, connected: true, mapping: "", axes: [rest], buttons: [] };
  const real = navigator.getGamepads;
  navigator.getGamepads = () => [pad];
  const lesson = new Lesson("hat");
  let now = 0;
  const wait = (value) => {
    pad.axes[0] = value;
    for (const end = now + 0.6; now < end;) lesson.feed(pad, (now += 0.02));
  };
  // Right and down, each by way of diagonals, as a thumb does.
  for (const value of [rest, -5 / 7, -3 / 7, -1 / 7, rest, 3 / 7, 1 / 7, rest]) wait(value);
  const pads = new Pads(() => lesson.mapping, () => {});
  pads.read();
  const wishes = values.map((value) => {
    pad.axes[0] = value;
    const { x, y } = pads.read().wish;
    return [x, y];
  });
  navigator.getGamepads = real;
  return wishes;
})
"""


@within(60.0)
async def test_a_hat_of_one_number_points_where_it_is_pushed() -> None:
    async with console() as made, Chromium() as browser:
        tab = await browser.open(made.url, GAMEPAD)
        await tab.until("document.querySelector('#pad-map') !== null", "the page")
        for rest in (9 / 7, 23 / 7, -9 / 7, 0.0):
            values = [*EIGHT, rest]
            wishes = await tab.run(f"({HELD_HAT})({rest}, {values})")
            for value, (x, y) in zip(values, wishes, strict=True):
                right, down = EIGHT.get(value, (0, 0))
                assert (round(x, 9) > 0) - (round(x, 9) < 0) == right, (rest, value, x)
                assert (round(y, 9) > 0) - (round(y, 9) < 0) == down, (rest, value, y)
                assert abs(x) == pytest.approx(abs(y)) or not right or not down


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
