"""A person who plays bowel grasping and retraction on the console's page, by the keyboard alone.

The person sees what the simulator says of the task, and presses and releases keys of the page.
"""

from __future__ import annotations

import asyncio
import time
from typing import Any

import numpy as np

import surg_core
from helpers.teleop.chromium import Tab, until
from helpers.teleop.phantom import Phantom
from surg_core.transforms import minimal_rotation
from surg_sim.physics.tissue_grasp import GRIP_DEPTH
from surg_sim.tasks.bgr.bgr_expert import (
    ABOVE,
    DEEPER,
    GRIP_HEIGHT,
    LIFT,
    PULL,
    UP,
    along,
    roll_across,
)
from surg_sim.tasks.scripted_sender import home_frame

KEYS = (("KeyA", "KeyD"), ("KeyW", "KeyS"), ("KeyF", "KeyR"))
"""Against and along each axis of the view: right, down, away."""
ROLL_RATE = 1.2
"""[rad/s] of the page's keys."""
FINE = 0.012
"""[m] from a place, from where on the person goes slowly."""
THERE = 0.0015
"""[m] from a place."""
GLANCE_S = 0.05
"""[s] between two looks at the page."""
ATTEMPTS = 10
"""Of the jaws on the bowel: a hold in between leaves them half open."""
LONGEST_S = 120.0
"""[s] for any one step: the machine may be busy."""


class Player:
    """Plays episodes in one tab, with both hands on the keyboard."""

    def __init__(self, made: Phantom, tab: Tab, cell: surg_core.Cell) -> None:
        self._made, self._tab = made, tab
        self._X_WR = home_frame(cell.arms["PSM1"])
        self._down: set[str] = set()
        self._J = np.eye(3)

    @property
    def seen(self) -> dict[str, Any]:
        """The task as it is."""
        return self._made.task[-1]

    def point(self, name: str) -> np.ndarray:
        """A place of the task in the world [m]."""
        return np.array(self.seen[name])

    async def hold(self, *codes: str) -> None:
        """Hold these keys down, and no others."""
        for code in self._down - set(codes):
            await self._tab.key(code, False)
        for code in set(codes) - self._down:
            await self._tab.key(code, True)
        self._down = set(codes)

    async def enable(self) -> None:
        """Press Enable until the tip follows; a busy machine lets go of it."""
        if await self._tab.run("surgConsole.status()?.headline") == "Following":
            return
        await self.hold()

        async def follows() -> bool:
            if await self._tab.run("surgConsole.status()?.headline") == "Following":
                return True
            await self._tab.tap("Enter")
            await asyncio.sleep(0.5)
            return False

        await until(follows, "the tip to follow", LONGEST_S)

    async def probe(self) -> None:
        """Learn which key moves the tip where in the world."""
        columns = []
        for pair in KEYS:
            for code, sign in zip(pair, (-1.0, 1.0), strict=True):
                while True:
                    await self.enable()
                    before = self.point("tip")
                    await self.hold(code)
                    await asyncio.sleep(0.4)
                    await self.hold()
                    await asyncio.sleep(0.4)
                    way = sign * (self.point("tip") - before)
                    if np.linalg.norm(way) > 0.002:
                        break
                columns.append(way / np.linalg.norm(way))
        self._J = np.array(columns).reshape(3, 2, 3).mean(axis=1).T

    async def go(self, place: np.ndarray, slowly: bool = False) -> None:
        """Bring the tip to a place of the world [m], key by key, unless the task ends before."""
        began = time.monotonic()
        inverse = np.linalg.inv(self._J)
        while np.linalg.norm(left := place - self.point("tip")) > THERE and not self.seen["done"]:
            assert time.monotonic() - began < LONGEST_S, (place, self.point("tip"), self.seen)
            await self.enable()
            wanted = inverse @ left
            most = np.abs(wanted).max()
            codes = [
                pair[int(way > 0)]
                for pair, way in zip(KEYS, wanted, strict=True)
                if abs(way) > max(0.3 * most, 0.4 * THERE)
            ]
            fine = slowly or np.linalg.norm(left) < FINE
            await self.hold(*codes, *(["ShiftLeft"] if fine else []))
            await asyncio.sleep(GLANCE_S)
        await self.hold()
        await asyncio.sleep(0.3)

    async def press(self, code: str, seconds: float) -> None:
        """Hold one key for a while."""
        await self.enable()
        await self.hold(code)
        await asyncio.sleep(seconds)
        await self.hold()
        await asyncio.sleep(0.3)

    async def phase(self, *names: str) -> None:
        """Wait for a phase of the task, or its success: on a busy machine phases may pass."""

        async def come() -> bool:
            await self.enable()
            assert not self.seen["done"] or self.seen["success"], self.seen["reason"]
            return self.seen["phase"] in names or self.seen["done"]

        await until(come, f"the phase {names}", LONGEST_S, 0.05)

    async def play(self) -> None:
        """One episode, from the tip at home to its end."""
        await self.phase("grasp")
        await self.press("KeyL", 1.0)
        node = int(self.seen["target"])
        place = self.point("nodes")[node]
        direction = place - self._X_WR[:3, 3]
        s = direction / np.linalg.norm(direction)
        y = minimal_rotation(self._X_WR[:3, 2], s) @ self._X_WR[:3, 1]
        roll = roll_across(s, y, along(self.point("nodes"), node))
        await self.press("KeyE" if roll > 0 else "KeyQ", abs(roll) / ROLL_RATE)
        grip = GRIP_HEIGHT * UP + GRIP_DEPTH * s
        await self.go(place + grip - ABOVE * s)
        for attempt in range(ATTEMPTS):
            deeper = min(attempt, 3) * DEEPER * UP
            await self.go(self.point("nodes")[node] + grip - deeper, slowly=True)
            await self.press("KeyK", 1.2)
            if self.seen["held"] >= 0:
                break
            await self.press("KeyL", 1.0)
        assert self.seen["held"] >= 0, self.seen
        await self.phase("retract", "still")
        if self.seen["done"]:  # the assistant alone has made it taut
            return
        await self.go(self.point("tip") + LIFT * UP)
        away = self.point("tip") - self.point("assistant_tip")
        away -= (away @ UP) * UP
        away /= np.linalg.norm(away)
        while not self.seen["done"]:
            if self.seen["tension"] < PULL:
                await self.go(self.point("tip") + 0.004 * away, slowly=True)
            else:
                await self.hold()
                await asyncio.sleep(0.1)
