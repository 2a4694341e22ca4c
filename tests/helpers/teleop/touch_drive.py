"""Drives a whole running system by fingers on a tablet's screen."""

from __future__ import annotations

import asyncio

import numpy as np

from helpers.teleop import steering
from helpers.teleop.chromium import Tab, until
from helpers.teleop.phantom import Phantom

METRES_PER_PIXEL = 0.0005
"""Of the hand, as docs/guide/console.md states for mouse and fingers."""
MIDDLE = np.array([340.0, 400.0])
"""[px] of the picture on the page."""
APART = np.array([60.0, 0.0])
"""[px] from the middle to each of two fingers."""
STEPS = 10


async def drag(tab: Tab, by: np.ndarray, *hold: np.ndarray) -> None:
    """Put fingers down beside the middle, draw them over the screen by (2,) [px], lift them."""
    start = MIDDLE - by / 2
    await tab.fingers("touchStart", *(start + each for each in hold))
    for step in range(1, STEPS + 1):
        at = start + by * step / STEPS
        await tab.fingers("touchMove", *(at + each for each in hold))
        await asyncio.sleep(0.02)
    await asyncio.sleep(0.15)
    await tab.fingers("touchEnd")


async def drive(tab: Tab) -> None:
    """Press Enable by a finger until the tip follows."""

    async def follows() -> bool:
        if await tab.run("surgConsole.status()?.headline") == "Following":
            return True
        await tab.fingers("touchStart", await tab.middle("#enable"))
        await tab.fingers("touchEnd")
        await asyncio.sleep(1.5)
        return False

    await until(follows, "following", 120.0, 0.1)


async def move(made: Phantom, tab: Tab, by: np.ndarray) -> None:
    """One finger moves the tip in the picture, two together along the view."""
    await drive(tab)
    across, away = by[:2] / METRES_PER_PIXEL, by[2] / METRES_PER_PIXEL
    if np.linalg.norm(across) > 1.0:
        await drag(tab, across, np.zeros(2))
    if abs(away) > 1.0:
        await drag(tab, np.array([0.0, -away]), -APART, APART)
    await steering.rest(made)
