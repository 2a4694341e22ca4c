"""A fast hand at the console while other programs want the same processors.

The arm may slow down, hold or pause. It may not leave its pivot. The simulator's truth decides, and
no figure depends on how fast the machine is.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.graph import busy_machine
from helpers.graph.surg import environment
from helpers.results.busy_results import note, note_stops
from helpers.teleop.console_attack import attack
from helpers.teleop.console_page import Page, page, when
from helpers.teleop.phantom import phantom, printed
from surg_cli.host import paths

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

SECONDS = float(os.environ.get("SURG_STORM_SECONDS", "600"))
HAND_SPEED = 0.5
"""[m/s]; a tenth of a metre a second at the tip."""
SCALE = 0.2
REACH = 0.1
"""[m] of the hand to each side."""


class Judged:
    """What `pivot_judge.py` has counted."""

    def __init__(self) -> None:
        self.seen: dict[str, Any] = {}

    def hear(self, line: bytes) -> None:
        self.seen = json.loads(line)


@contextlib.asynccontextmanager
async def system(folder: Path, cell: str, arm: str) -> AsyncIterator[tuple[int, Judged]]:
    """A running `./surg teleop` with its console's port, and the judge of one arm."""
    judged = Judged()
    async with (
        phantom(folder, cell, of=()) as made,
        printed("pivot_judge.py", arm, made.port, judged.hear),
    ):
        await when(lambda: judged.seen.get("cycles"), "the arm's cycles", 60.0)
        yield made.web, judged


async def drive(found: Page) -> None:
    """Enable until the tip follows; beside other programs it takes more than one try."""
    for attempt in range(5):
        try:
            await found.drive()
            return
        except AssertionError:
            if attempt == 4:
                raise
            found.fall_silent()


async def storm(found: Page, rng: np.random.Generator, until: float, scope: float) -> int:
    """A hand to and fro at full speed, clutching, changing its way and its arm; presses when held.

    Args:
        found: The page.
        rng: Of the storm.
        until: Its end on the steady clock [s].
        scope: Share of time with the camera's pedal down.

    Returns:
        How often the operator had to enable anew.
    """
    enabled, pressed = 0, 0.0
    hand, way = np.zeros(3), np.array([1.0, 0.0, 0.0])
    before, change = time.monotonic(), 0.0
    clutch = camera = False
    while time.monotonic() < until:
        now = time.monotonic()
        hand += HAND_SPEED * (now - before) * way
        before = now
        outside = np.linalg.norm(hand) > REACH
        if now > change or outside:
            way = rng.normal(size=3) * (1, 1, 0.5)
            way /= np.linalg.norm(way)
            if outside and hand @ way > 0:
                way = -way
            clutch, camera = bool(rng.random() < 0.15), bool(rng.random() < scope)
            change = now + rng.uniform(0.05, 0.6)
        p = hand.round(5).tolist()
        found.hand = {"hand": "position", "p": p, "clutch": clutch, "camera": camera}
        if found.status["phase"] != "driving" and now > pressed + 1.0:
            pressed = now
            enabled += 1
            await found.press("enable")
        await asyncio.sleep(0.01)
    return enabled


@pytest.mark.full
@pytest.mark.parametrize(
    ("cell", "arm", "scope"),
    [("sim_ur5e", "PSM1", 0.0), ("sim_panda", "PSM1", 0.0), ("sim_two_arms", "ECM", 0.7)],
)
def test_a_fast_hand_on_a_busy_machine_never_leaves_the_pivot(
    tmp_path: Path, cell: str, arm: str, scope: float
) -> None:
    rng = np.random.default_rng(7)

    async def test() -> None:
        async with system(tmp_path, cell, arm) as (web, judged), page(web) as found:
            found.hand = {"hand": "position", "p": [0.0, 0.0, 0.0]}
            await drive(found)
            await found.say("scale", value=SCALE)
            with busy_machine.busy():
                began = time.monotonic()
                enabled = await storm(found, rng, began + SECONDS, scope)
            await asyncio.sleep(1.0)
            seen = judged.seen
            note(f"{cell}, {arm}", SECONDS, os.getloadavg()[0], enabled, seen)
            assert seen["way_m"] > 0.002 * SECONDS, "the arm hardly moved"
            assert "FAULT(rcm_error)" not in seen["ended"]
            assert seen["pivot_mm"] <= 0.5

    asyncio.run(test())


STOPS = 20 if os.environ.get("SURG_TEST_FULL") else 3
STOP_WITHIN = 0.2
"""[s] From the command's start to the first cycle in which the arm is no longer enabled."""


@pytest.mark.full  # it stops every system of this checkout
@pytest.mark.parametrize("around", ["quiet", "attack", "load"])
def test_stop_pauses_at_once(tmp_path: Path, around: str) -> None:
    """`./surg stop` while a page drives; beside it nothing, an attack on the console, or a load."""
    took: list[float] = []
    typed = {name: value for name, value in environment().items() if name != "SURG_READY"}

    async def stop(found: Page, judged: Judged) -> None:
        await drive(found)
        await when(lambda: judged.seen["state"] == "ENABLED", "the judge's ENABLED", 5.0)
        began = time.monotonic()
        done = await asyncio.create_subprocess_exec(str(paths.ROOT / "surg"), "stop", env=typed)
        assert await done.wait() == 0
        await asyncio.sleep(1.0)  # the judge writes twice a second
        assert judged.seen["state"] == "PAUSED"
        if judged.seen["left_at"] > began:  # the attack has not held the arm before
            took.append(judged.seen["left_at"] - began)
        found.fall_silent()

    async def test() -> None:
        async with contextlib.AsyncExitStack() as stack:
            web, judged = await stack.enter_async_context(system(tmp_path, "sim_ur5e", "PSM1"))
            found = await stack.enter_async_context(page(web))
            found.hand = {"hand": "position", "p": [0.0, 0.0, 0.0]}
            if around == "attack":
                await stack.enter_async_context(attack(web, 600.0, half_open=1200, pages=8))
            elif around == "load":
                stack.enter_context(busy_machine.busy())
            for _ in range(3 * STOPS):
                if len(took) < STOPS:
                    await stop(found, judged)

    asyncio.run(test())
    assert len(took) == STOPS
    note_stops(around, took)
    if os.environ.get("SURG_TEST_FULL"):
        assert max(took) < STOP_WITHIN
