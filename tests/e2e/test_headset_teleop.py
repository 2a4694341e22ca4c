"""`./surg teleop --stereo` whole, with the page /headset and a headset that is not there."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import aiohttp
import numpy as np
import pytest

from helpers.async_tests import within
from helpers.results.screen_results import note_age, note_targets
from helpers.teleop import chromium, steering
from helpers.teleop.chromium import Chromium, Tab
from helpers.teleop.console_page import socket_of, when
from helpers.teleop.headset import FAKE_XR
from helpers.teleop.headset_drive import HEADLINE, squeezed
from helpers.teleop.headset_page import SQUEEZE, B, hold
from helpers.teleop.phantom import Phantom, phantom

pytestmark = [
    pytest.mark.ros,
    pytest.mark.full,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]

FAR = 0.002
"""[m] that a tip must go, to have moved."""
STANDS = 0.0002
"""[m] that a tip which stands may tremble."""
TARGETS = 3


async def gone(made: Phantom, tab: Tab, hand: str, wanted: str, by: list[float]) -> np.ndarray:
    """How far the driven tip comes while a hand moves in small steps, (3,) [m] in its rcm frame."""
    tips = made.lens if hand == "left" else made.tips
    other = made.tips if hand == "left" else made.lens
    for _ in range(8):  # a busy machine may let go in between
        await squeezed(tab, hand, wanted)
        start, stood = tips[-1][1], other[-1][1]
        for _ in range(20):
            await tab.run(f"fakeXR.move('{hand}', {(np.array(by) / 20).tolist()})")
            await asyncio.sleep(0.03)
        await asyncio.sleep(0.5)
        way = tips[-1][1] - start
        assert np.linalg.norm(other[-1][1] - stood) < STANDS, "the other arm stands"
        if np.linalg.norm(way) > FAR:
            return np.asarray(way)
    raise AssertionError(f"the {hand} hand moved nothing: {await tab.run(HEADLINE)}")


@within(500.0)
async def test_the_controllers_drive_both_arms_of_bgr_and_nothing_moves_without_a_squeeze(
    tmp_path: Path,
) -> None:
    more = ("--cameras", "stereo")
    async with phantom(tmp_path, "sim_two_arms", *more) as made, Chromium() as browser:
        tab = await browser.open(f"{made.url}headset", FAKE_XR)
        await tab.until("!document.querySelector('#enter').disabled", "the headset", 60.0)
        await tab.click("#enter")
        await tab.until("surgHeadset.picture.drawn.length > 10", "pictures", 120.0)
        right = await gone(made, tab, "right", "Following", [0.04, 0.0, 0.0])
        up = await gone(made, tab, "right", "Following", [0.0, 0.04, 0.0])
        away = await gone(made, tab, "right", "Following", [0.0, 0.0, -0.04])
        ways = np.array([right, up, away])
        lengths = np.linalg.norm(ways, axis=1)
        print("ways [mm]:", np.round(1e3 * ways, 2).tolist())
        angles = (ways / lengths[:, None]) @ (ways / lengths[:, None]).T
        assert np.abs(angles - np.eye(3)).max() < 0.2, "three directions, at right angles"
        assert np.linalg.det(ways) < 0, "right, up, towards the viewer are right-handed"

        for other in ("left", "right"):
            await hold(tab, other, SQUEEZE, 0)
        await asyncio.sleep(0.5)
        start = made.tip, made.lens[-1][1]
        for hand in ("left", "right"):
            await tab.run(f"fakeXR.move('{hand}', [0.05, 0.05, -0.05])")
        await asyncio.sleep(1.0)
        assert np.linalg.norm(made.tip - start[0]) < STANDS, "no squeeze"
        assert np.linalg.norm(made.lens[-1][1] - start[1]) < STANDS, "no squeeze"

        await gone(made, tab, "left", "Endoscope", [0.0, 0.0, -0.04])
        drawn = await tab.run("surgHeadset.picture.drawn.map((each) => each.ageMs)")
        seconds = await tab.run(
            "(surgHeadset.picture.drawn.at(-1).drawnUs - surgHeadset.picture.drawn[0].drawnUs)"
            " / 1e6"
        )
        note_age(drawn, seconds)
        await hold(tab, "right", B, 1)
        await tab.until("surgHeadset.status().phase === 'held'", "the stop", 30.0)
        assert browser.errors == []


class TipInPicture:
    """Where the instrument's tip is in the pictures, from the console's socket /marks."""

    def __init__(self) -> None:
        self.newest: dict[str, tuple[float, float]] = {}
        self.exposed_us = 0

    async def read(self, port: int) -> None:
        """Until cancelled."""
        async with aiohttp.ClientSession() as http:
            socket = await socket_of(http, port, "marks")
            async for message in socket:
                said = message.json()
                self.exposed_us = said["exposed_us"]
                for mark in said["marks"]:
                    if (mark["arm"], mark["name"]) == ("PSM1", "tip") and mark["points"][0]:
                        self.newest[mark["eye"]] = tuple(mark["points"][0])

    async def seen(self) -> np.ndarray:
        """(3,) pixels right, pixels down, and disparity, which shrinks with the distance; now."""
        now_us = time.time_ns() // 1000
        await when(lambda: self.exposed_us > now_us, "a mark of now", 30.0)
        left, right = (np.array(self.newest[eye]) for eye in ("left", "right"))
        return np.array([*left, left[0] - right[0]])


async def carry(made: Phantom, tab: Tab, by: np.ndarray) -> None:
    """The squeezed right hand goes by (3,) [m] right, down, away from the operator."""
    await squeezed(tab, "right", "Following")
    room = (by * [1.0, -1.0, -1.0]).tolist()  # the room's y is up, its z towards the operator
    for _ in range(15):
        await tab.run(f"fakeXR.move('right', {[each / 15 for each in room]})")
        await asyncio.sleep(0.03)
    await steering.rest(made)


@within(580.0)
async def test_the_instrument_goes_where_the_picture_says_and_touches_three_targets(
    tmp_path: Path,
) -> None:
    more = ("--cameras", "marks")  # both eyes, and where the tip is in them
    async with phantom(tmp_path, "sim_two_arms", *more) as made, Chromium() as browser:
        tab = await browser.open(f"{made.url}headset", FAKE_XR)
        await tab.until("!document.querySelector('#enter').disabled", "the headset", 60.0)
        await tab.click("#enter")
        await tab.until("surgHeadset.picture.drawn.length > 10", "pictures", 120.0)
        await squeezed(tab, "right", "Following")
        await when(lambda: made.tips, "a first place of the tip", 60.0)
        tip = TipInPicture()
        reading = asyncio.create_task(tip.read(made.web))
        await when(lambda: len(tip.newest) == 2, "marks of both eyes", 60.0)
        for axis, sign in enumerate((1.0, 1.0, -1.0)):  # right, down, away: less disparity
            before, stood = await tip.seen(), made.tip
            for _ in range(8):  # a busy machine may let go in between
                await carry(made, tab, 0.04 * np.eye(3)[axis])
                if np.linalg.norm(made.tip - stood) > 2 * FAR:
                    break
            way = sign * (await tip.seen() - before)
            print(f"axis {axis}: {way.round(1).tolist()} px")
            assert way[axis] > (5.0 if axis < 2 else 0.5), "right, down, away in the picture"
            if axis < 2:
                assert abs(way[1 - axis]) < 0.35 * way[axis]
        J = await steering.probe(made, lambda by: carry(made, tab, by))
        steering.one_hand_frame(J)
        rng = np.random.default_rng(41)
        home, took = made.tip, []
        for _ in range(TARGETS):
            target = home + rng.uniform(-0.01, 0.01, 3)
            took.append(await steering.touch(made, lambda by: carry(made, tab, by), J, target))
            print(f"target {len(took)}: {took[-1]:.1f} s")
        note_targets(took)
        reading.cancel()
        assert browser.errors == []
