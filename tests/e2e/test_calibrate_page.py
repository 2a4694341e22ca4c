"""The page /calibrate in Chromium: what it shows, its keys, and that it moves nothing."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.async_tests import within
from helpers.sim.board_views import BARREL, BOARD, bench
from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium
from helpers.teleop.console import Console, console
from helpers.teleop.console_page import when
from surg_console.ros.status_values_node import calibration_of
from surg_console.session.console_orders import Calibrate
from surg_msgs.msg import CalibrationStatus

pytestmark = pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing())

SIZE = (1366, 768)
TOKEN = "0123456789abcdef0123"
COLUMNS, ROWS = 5, 4
NEEDED = tuple(k not in (0, 4, 15, 19) for k in range(COLUMNS * ROWS))


def held_board() -> tuple[np.ndarray, tuple[float, ...]]:
    """A picture (h, w, 3) of a board, and its corners as shares of the picture."""
    of = bench(3, BARREL, pixels=30)
    view = next(of.held_board(1))
    left, _ = of.pictures(view)
    share = (of.pixels(view, BOARD.corners)[0] + 0.5) / np.array(of.size)
    inside = share[((share > 0.0) & (share < 1.0)).all(axis=1)]
    return np.repeat(left[..., None], 3, axis=2), tuple(map(float, inside.ravel()))


COLLECTING: dict[str, Any] = {
    "state": CalibrationStatus.STATE_COLLECTING,
    "step": CalibrationStatus.STEP_STEREO,
    "views": 9,
    "wanted": 20,
    "progress": 0.61,
    "hint": "View taken. Next: the board in the bottom, right of the picture.",
    "missing": [
        "the board in the bottom, right of the picture",
        "a board nearer than 70 mm (2 of 3 views)",
        "a board tilted to the left or right (1 of 3 views)",
        "11 more views",
    ],
    "columns": COLUMNS,
    "rows": ROWS,
    "fields": [0, 1, 2, 2, 0, 1, 4, 5, 3, 1, 1, 3, 4, 2, 0, 0, 1, 1, 0, 0],
    "needed": NEEDED,
    "folder": "runs/2026-11-23T13-00-00Z/views/stereo",
}


def set_calibration(made: Console, **changes: object) -> None:
    now = CalibrationStatus(**{**COLLECTING, **changes})
    made.system.now = replace(made.system.now, calibration=calibration_of(now))


@within(120.0)
async def test_the_page_shows_what_is_covered_and_passes_requests_on(tmp_path: Path) -> None:
    picture, corners = held_board()
    async with console(token=TOKEN) as made, Chromium(SIZE) as browser:
        made.camera.picture = lambda count: picture  # type: ignore[method-assign]
        tab = await browser.open(f"{made.url}calibrate#token={TOKEN}")
        ready = "globalThis.surgCalibrate && surgCalibrate.picture.drawn > 2"
        await tab.until(ready, "pictures", 60.0)
        hint = "document.querySelector('#hint').textContent"
        await tab.until(f"{hint}.includes('./surg calibrate test_cell live')", "how to start one")
        assert await tab.run("document.querySelector('#stereo').disabled")
        await tab.tap("Digit1")  # nothing to ask
        set_calibration(made, corners=corners)
        await tab.until("surgCalibrate.status().views === 9", "the status")
        assert await tab.run(hint) == COLLECTING["hint"]
        texts = "[...document.querySelectorAll('#missing li')].map((li) => li.textContent)"
        assert await tab.run(texts) == COLLECTING["missing"]
        for keys, request in (
            ("Digit1", "START_STEREO"), ("Digit2", "START_HANDEYE"), ("KeyU", "UNDO"),
            ("KeyS", "SOLVE"),
        ):  # fmt: skip
            await tab.tap(keys)
            wanted = Calibrate(request)
            await when(lambda w=wanted: w in made.system.given(Calibrate), request, 20.0)
        await tab.click("#undo")
        await when(lambda: len(made.system.given(Calibrate)) == 5, "the button", 20.0)
        covered, empty = await tab.run(PIXELS)
        assert covered[3] > 20 and empty[3] == 0, "a covered field is filled"
        await shoot(tab, tmp_path)
        for state, residual in (("SOLVING", np.nan), ("DONE", 0.069)):
            number = getattr(CalibrationStatus, f"STATE_{state}")
            set_calibration(made, state=number, views=20, residual=residual, missing=[])
            await tab.until(f"surgCalibrate.status().state === '{state}'", state)
        assert await tab.run("surgCalibrate.solutions[0].residual") == pytest.approx(0.069)
        await tab.until(
            "document.querySelector('#solutions').textContent.includes('0.069 px')", "result"
        )
        assert made.session.pages == 0, "the page is on no socket of the session"
        moving = {type(order) for _, order in made.system.orders} - {Calibrate}
        assert not moving, moving
        fits = "(() => { const a = document.querySelector('aside'), b = a.getBoundingClientRect();"
        fits += " return [...a.querySelectorAll('button')].every((each) =>"
        fits += " each.getBoundingClientRect().right <= b.right - 12"
        fits += " && each.scrollWidth <= each.clientWidth) && a.scrollHeight <= a.clientHeight })()"
        assert await tab.run(fits), "buttons and lists lie within the panel"
        assert browser.errors == []


PIXELS = """(() => {
  const c = document.querySelector('#grid'), x = c.getContext('2d');
  const at = (column, row) => [...x.getImageData(
    Math.round((column + 0.5) * c.width / 5), Math.round((row + 0.2) * c.height / 4), 1, 1).data];
  return [at(1, 0), at(4, 2)];
})()"""


async def shoot(tab: Any, tmp_path: Path) -> None:
    """The page as a picture: to look at, and for the guide."""
    file = Path(os.environ.get("SURG_CALIBRATE_SHOT", tmp_path / "calibrate.png"))
    await tab.screenshot(file)
    assert file.stat().st_size > 10_000
