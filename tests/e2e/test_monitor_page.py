"""The page /monitor in Chromium: each format by its pixels, and that the page moves nothing."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import numpy as np
import pytest

from helpers.async_tests import within
from helpers.results.screen_results import FORMATS, note_times
from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium, Tab, until
from helpers.teleop.console import Console, console
from helpers.teleop.headset import NO_WEBGL
from surg_console.session.console_orders import EnableTeleop, SetOperatorPresent
from surg_console.session.console_session import Phase

pytestmark = pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing())

WIDTH, HEIGHT = 640, 360
LEFT = ((200, 60, 60), (60, 160, 60), (160, 160, 60), (90, 90, 90))
RIGHT = ((40, 60, 200), (60, 170, 190), (170, 60, 170), (220, 220, 220))
"""Colours of the four quarters of each eye: upper left, upper right, lower left, lower right."""
TEXT = 0.3
"""Upper part of an eye's picture that may carry the state."""
NEAR = 6
"""[px] from an edge between two colours that the codec may smear."""


def quarters(colours: tuple[tuple[int, int, int], ...], width: int, height: int) -> np.ndarray:
    """A picture (h, w, 3) of four flat quarters."""
    top, bottom = np.arange(height) < height // 2, np.arange(width) < width // 2
    which = np.where(top[:, None], 0, 2) + np.where(bottom[None, :], 0, 1)
    return np.array(colours, np.uint8)[which]


def expected(form: str, swap: bool) -> np.ndarray:
    """What a display of WIDTH x HEIGHT shows (h, w, 3), by its definition, pixel by pixel."""
    eyes = [LEFT, RIGHT][:: -1 if swap else 1]
    first, second = (quarters(eye, WIDTH, HEIGHT).astype(int) for eye in eyes)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    if form in ("left", "right"):
        return first if form == "left" else second
    if form == "sbs":
        return np.hstack([quarters(eye, WIDTH // 2, HEIGHT) for eye in eyes]).astype(int)
    if form == "top_bottom":
        return np.vstack([quarters(eye, WIDTH, HEIGHT // 2) for eye in eyes]).astype(int)
    if form == "anaglyph":
        return np.dstack([first[..., :1], second[..., 1:]])
    is_first = {"rows": y % 2 == 0, "columns": x % 2 == 0, "checker": (x + y) % 2 == 0}[form]
    return np.where(is_first[..., None], first, second)


def flat(form: str) -> np.ndarray:
    """(h, w) pixels that are compared: off the edges between colours, below the text."""
    parts = {"sbs": (2, 1), "top_bottom": (1, 2)}.get(form, (1, 1))
    wide, tall = WIDTH // parts[0], HEIGHT // parts[1]
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    y, x = y % tall, x % wide
    off_x = np.minimum.reduce([x, abs(x - wide // 2), wide - 1 - x]) > NEAR
    off_y = np.minimum.reduce([y, abs(y - tall // 2), tall - 1 - y]) > NEAR
    return off_x & off_y & (y > TEXT * tall)


async def opened(made: Console, browser: Chromium, query: str = "") -> Tab:
    """The page on a screen of WIDTH x HEIGHT, with pictures."""
    made.camera.eyes = (quarters(LEFT, 320, 180), quarters(RIGHT, 320, 180))
    tab = await browser.open(f"{made.url}monitor?shift=0{query}", screen=(WIDTH, HEIGHT))
    await tab.until("globalThis.surgMonitor?.picture.drawn.length > 2", "pictures", 60.0)
    await tab.run("document.querySelector('#stop').hidden = true")  # it would stay over the picture
    return tab


@within(120.0)
async def test_every_format_gives_each_eye_its_pixels() -> None:
    async with console() as made, Chromium() as browser:
        tab = await opened(made, browser)
        forms = ["left", "right", "sbs", "top_bottom", "rows", "columns", "checker", "anaglyph"]
        for number, form in enumerate(forms, 1):
            await tab.tap(f"Digit{number}")
            for swap in (False, True):
                await tab.run("document.body.dataset.idle = 'true', 0")
                wanted, compared = expected(form, swap), flat(form)

                async def right(w: np.ndarray = wanted, c: np.ndarray = compared) -> bool:
                    found = await tab.pixels()
                    return bool((np.abs(found - w).max(axis=2)[c] < 16).all())

                await until(right, f"{form}, swapped: {swap}", 10.0, 0.1)
                await tab.tap("KeyX")
        assert "format=anaglyph" in await tab.run("location.search"), "kept in the address"
        assert browser.errors == []


@pytest.mark.full
@within(120.0)
async def test_the_scene_is_pushed_back_and_a_test_picture_tells_the_eyes_apart(
    tmp_path: Path,
) -> None:
    async with console() as made, Chromium() as browser:
        tab = await opened(made, browser, "&format=left")
        row = round(0.6 * HEIGHT)  # the border between the lower quarters lies in the middle

        async def border() -> float:
            await tab.run("document.body.dataset.idle = 'true', 0")
            return float(np.argmax((await tab.pixels())[row, :, 0] < 125))

        async def at(place: float) -> bool:
            return abs(await border() - place) < 5

        before = await border()
        await tab.run(
            "(() => { const s = document.querySelector('#shift'); s.value = 8;"
            " s.dispatchEvent(new Event('input')) })()"
        )
        # The left eye's picture goes left and the right eye's right, by half of 8 % each.
        await until(lambda: at(before - 0.04 * WIDTH), "the left eye", 10.0, 0.1)
        await tab.tap("Digit2")
        await tab.tap("KeyT")
        await tab.until("surgMonitor.settings.test", "the test picture")
        await asyncio.sleep(0.5)
        blue = (await tab.pixels())[row, WIDTH // 4]
        assert blue[2] > 2 * blue[0], blue
        await tab.screenshot(Path(os.environ.get("SURG_MONITOR_SHOT", tmp_path / "monitor.png")))
        assert browser.errors == []


@pytest.mark.full
@within(120.0)
async def test_the_page_moves_nothing_and_its_stop_is_obeyed() -> None:
    async with console() as made, Chromium() as browser:
        tab = await opened(made, browser)
        assert made.session.pages == 0 and made.session.holder == ""
        for code in ("Enter", "KeyD", "KeyV", "KeyP", "Space"):
            await tab.tap(code)
        await tab.run("link = null, 0")
        await asyncio.sleep(0.3)
        assert made.system.orders == []
        await tab.tap("KeyS")

        async def stopped() -> bool:
            return made.system.given(EnableTeleop)[-1:] == [EnableTeleop(False)]

        await until(stopped, "the stop", 10.0)
        assert made.system.given(SetOperatorPresent)[-1] == SetOperatorPresent(False)
        assert made.session.phase is Phase.FREE
        assert browser.errors == []


@pytest.mark.full
@within(120.0)
async def test_what_would_spoil_rows_is_said_and_no_webgl_is_needed() -> None:
    async with console() as made, Chromium((WIDTH, HEIGHT)) as browser:
        tab = await browser.open(f"{made.url}monitor?format=rows", NO_WEBGL)
        await tab.until("surgMonitor.picture.drawn.length > 3", "pictures", 60.0)
        advice = "document.querySelector('#advice').textContent"
        # In a window the first row may be an odd one of the screen.
        await tab.until(f"{advice}.includes('full screen (F), or an odd offset')", "the offset")
        size = {"width": WIDTH, "height": HEIGHT, "mobile": False}
        await tab.run(
            "Object.defineProperty(document, 'fullscreenElement', {value: document.body}), 0"
        )
        for scale, said in (
            (1.25, f"{advice}.includes('scaling to 100 %')"),
            (1, f"{advice} === ''"),
        ):
            await tab.call("Emulation.setDeviceMetricsOverride", deviceScaleFactor=scale, **size)
            await tab.run("dispatchEvent(new Event('resize'))")
            await tab.until(said, f"scale {scale}")
        assert browser.errors == []


TIMES = """(async (format) => {
  const { Display } = await import("/page/eyes.js");
  const [width, height] = [1280, 480], pixels = width * height;
  globalThis.yuv ??= new Uint8Array(pixels * 3 / 2).map((_, i) => (i * 7919) >> 5);
  const canvas = new OffscreenCanvas(1920, format === "frame_packed" ? 2205 : 1080);
  const display = new Display(canvas), times = [];
  for (let i = 0; i < PICTURES; i += 1) {
    const shape = { format: "I420", codedWidth: width, codedHeight: height, timestamp: i };
    const frame = new VideoFrame(yuv, shape);
    const began = performance.now();
    display.draw(frame, { width, height }, { format, shift: 0.035 });
    display.context.getImageData(0, 0, 1, 1); // a canvas draws when it is read
    times.push(performance.now() - began);
    frame.close();
  }
  return times;
})"""
PICTURES = 20
LIMITS = {"left": 10.0, "right": 10.0, "sbs": 10.0, "top_bottom": 10.0, "rows": 30.0}
"""[ms] of processor time."""


@pytest.mark.full
@within(120.0)
async def test_a_picture_of_1080p_is_drawn_in_time() -> None:
    """In processor time, which other programs disturb less than the clock."""
    async with console() as made, Chromium() as browser:
        tab = await browser.open(f"{made.url}page/mark.svg")
        await asyncio.sleep(2.0)  # a browser that has just started still has work of its own
        for form in FORMATS:
            script = TIMES.replace("PICTURES", "10")
            await tab.run(f"{script}({form!r})")  # the first pictures prepare masks
            before = browser.processor_time()
            times = await tab.run(f"{TIMES.replace('PICTURES', str(PICTURES))}({form!r})")
            spent = 1e3 * (browser.processor_time() - before) / PICTURES
            note_times(form, spent, times, LIMITS)
            assert spent < 3 * LIMITS.get(form, 50.0), form
