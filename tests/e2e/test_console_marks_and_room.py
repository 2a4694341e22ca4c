"""Marks over the operator's picture and the room beside it, in Chromium."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.async_tests import within
from helpers.teleop import chromium
from helpers.teleop.chromium import Tab, until
from helpers.teleop.console import Console, opened
from helpers.teleop.console_page import when
from surg_cli.host import paths
from surg_console.session.scene_view import SceneView
from surg_console.web.picture_packet import Packet

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]

TIP = {"left": (200.0, 120.0), "right": (180.0, 120.0)}
"""[px] in an eye of 320 x 240."""
SIZES = ((1366, 768, False), (1024, 768, True), (390, 844, True))


def marked(made: Console, late_us: int = 0) -> None:
    """From now on each picture's marks come just before it; `late_us`: with another stamp."""
    show = type(made.server).show

    def both(packet: Packet) -> None:
        marks = [
            {"arm": "PSM1", "name": "tip", "eye": eye, "points": [list(at)], "ellipse": [30, 8, 0]}
            for eye, at in TIP.items()
        ]
        exposed = packet.exposed_us - late_us
        size = {"exposed_us": exposed, "width": 320, "height": 240}
        made.system.shown["marks"] = json.dumps({"say": "marks", **size, "marks": marks})
        show(made.server, packet)

    made.server.show = both  # type: ignore[method-assign]


async def painted(tab: Tab) -> list[list[int]]:
    """Boxes [left, top, right, bottom] of what is painted in each half of the marks' canvas."""
    script = """(() => {
      const c = document.querySelector('#marks');
      const boxes = [];
      for (const [from, to] of [[0, c.width > 480 ? 320 : c.width], [320, c.width]]) {
        if (to <= from) continue;
        const d = c.getContext('2d').getImageData(from, 0, to - from, c.height).data;
        let box = [1e9, 1e9, -1, -1];
        for (let i = 0; i < d.length / 4; i += 1) if (d[4 * i + 3] > 64) {
          const x = i % (to - from), y = Math.floor(i / (to - from));
          box = [Math.min(box[0], x), Math.min(box[1], y),
            Math.max(box[2], x), Math.max(box[3], y)];
        }
        boxes.push(box);
      }
      return boxes;
    })()"""
    found: Any = await tab.run(script)
    return [list(map(int, box)) for box in found]


@within(120.0)
async def test_marks_stand_on_their_own_picture_in_both_eyes_and_only_when_asked() -> None:
    async with opened() as (made, _, tab):
        marked(made)
        await asyncio.sleep(0.3)
        assert made.system.watched == frozenset(), "off by default"
        assert await tab.run("document.querySelector('#marks').hidden")
        await tab.tap("KeyN")
        await when(lambda: made.system.watched == {"marks"}, "the socket", 10.0)
        await tab.until("surgConsole.marks.drawn !== null", "marks", 20.0)

        async def in_place(eyes: tuple[str, ...]) -> bool:
            boxes = await painted(tab)
            if len(boxes) != len(eyes):
                return False
            # Two sigma are 30 px to both sides and 8 px up and down.
            wanted = [(x - 30, y - 8, x + 30, y + 8) for x, y in (TIP[eye] for eye in eyes)]
            return bool(np.abs(np.array(boxes) - wanted).max() <= 2)

        await until(lambda: in_place(("left",)), "the left eye's mark", 10.0)
        await tab.tap("KeyB")
        await until(lambda: in_place(("left", "right")), "both eyes' marks", 20.0)
        # Marks of another time than the picture's are not drawn.
        marked(made, late_us=30_000)
        await tab.until("surgConsole.marks.drawn === null", "no mark", 10.0)
        await asyncio.sleep(0.5)
        assert await tab.run("surgConsole.marks.drawn === null")
        await tab.tap("KeyN")
        await when(lambda: not made.system.watched, "the end", 10.0)
        assert made.system.orders == []


@within(90.0)
async def test_who_sends_no_marks_is_said_with_the_cure() -> None:
    async with opened() as (_, _, tab):
        await tab.tap("KeyN")
        said = "!document.querySelector('#toast').hidden"
        said += " && document.querySelector('#toast').textContent.includes('--cameras marks')"
        await tab.until(said, "the cure", 10.0)


@within(120.0)
async def test_the_room_shows_the_arms_turns_and_moves_nothing(tmp_path: Path) -> None:
    folder = Path(os.environ.get("SURG_SCREEN_SHOTS", tmp_path))
    cell = surg_core.load_cell(paths.CELLS / "sim_two_arms")
    joints = {name: np.array(arm.robot.home) for name, arm in cell.arms.items()}
    view = SceneView(cell)
    async with opened() as (made, _, tab):
        assert made.system.watched == frozenset()
        wide = await tab.run("document.querySelector('#view').clientWidth")
        made.system.shown["scene"] = json.dumps(view.as_json(joints))
        await tab.tap("KeyO")
        await tab.until("surgConsole.scene.drawn > 0", "the room", 20.0)
        assert await tab.run("document.querySelector('#view').clientWidth") < wide
        # Nothing moves: nothing is drawn.
        drawn = await tab.run("surgConsole.scene.drawn")
        await asyncio.sleep(0.6)
        assert await tab.run("surgConsole.scene.drawn") == drawn
        # A drag in the room turns it, and is no motion of the hand.
        x, y = await tab.middle("#room")
        await tab.mouse("mousePressed", x, y, button="left", buttons=1)
        await tab.mouse("mouseMoved", x + 50, y, button="left", buttons=1)
        await tab.mouse("mouseReleased", x + 50, y, button="left")
        assert await tab.run("surgConsole.scene.drawn") > drawn
        assert await tab.run("Object.values(surgConsole.hand.goal)") == [0, 0, 0, 0]
        del joints["PSM1"]
        made.system.shown["scene"] = json.dumps(view.as_json(joints))
        note = "document.querySelector('#scene-note').textContent"
        await tab.until(f"{note} === 'PSM1: no joints'", "the silent arm", 10.0)
        for width, height, touch in SIZES:
            await tab.resize(width, height, touch)
            await asyncio.sleep(0.4)
            for part in ("#view", "#scene", "#stop", "#enable"):
                seen = f"""(() => {{ const b = document.querySelector('{part}')
                  .getBoundingClientRect(); return b.width > 0 && b.left >= 0 && b.top >= 0
                  && b.right <= innerWidth && b.bottom <= innerHeight }})()"""
                assert await tab.run(seen), (width, part)
            await tab.screenshot(folder / f"room_{width}.png")
        await tab.tap("KeyO")
        await when(lambda: not made.system.watched, "the end", 10.0)
        assert made.system.orders == []
