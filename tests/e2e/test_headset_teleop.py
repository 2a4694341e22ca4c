"""`./surg teleop --stereo` whole, with the page /headset and a headset that is not there."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium, Tab, until
from helpers.teleop.headset import FAKE_XR
from helpers.teleop.headset_page import SQUEEZE, A, B, hold
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
HEADLINE = "surgHeadset.status()?.headline"


async def squeezed(tab: Tab, hand: str, wanted: str) -> None:
    """Enable where needed, let all go, squeeze: until the page says what follows."""

    async def follows() -> bool:
        for other in ("left", "right"):
            await hold(tab, other, SQUEEZE, 0)
        if await tab.run("surgHeadset.status()?.phase") != "driving":
            await hold(tab, "right", A, 1)
            await asyncio.sleep(0.2)
            await hold(tab, "right", A, 0)
            await asyncio.sleep(1.5)
        await hold(tab, hand, SQUEEZE, 1)
        await asyncio.sleep(0.5)
        return bool(await tab.run(HEADLINE) == wanted)

    await until(follows, f"{hand}: {wanted}", 120.0, 0.1)


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


def test_the_controllers_drive_both_arms_of_bgr_and_nothing_moves_without_a_squeeze(
    tmp_path: Path,
) -> None:
    async def test() -> None:
        more = ("--stereo",)
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
            print(
                f"age of the drawn pair: {np.median(drawn):.0f} ms p50, "
                f"{np.quantile(drawn, 0.99):.0f} p99, {len(drawn) / seconds:.1f} pictures/s"
            )
            await hold(tab, "right", B, 1)
            await tab.until("surgHeadset.status().phase === 'held'", "the stop", 30.0)
            assert browser.errors == []

    asyncio.run(asyncio.wait_for(test(), 500.0))
