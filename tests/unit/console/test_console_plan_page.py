"""What a policy plans and sees, over the operator's picture, in Chromium."""

from __future__ import annotations

import asyncio
import base64
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.async_tests import within
from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium, Tab
from helpers.teleop.console import Console, console
from helpers.teleop.console_page import when
from surg_console.session.system_state import PolicyServer

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]

WAY = [[0.25, 0.5], [0.375, 0.5], None, [0.5, 0.25]]
POINT = [0.75, 0.75]


def planned(made: Console, seq: int, **changes: Any) -> None:
    """A plan from now on."""
    made.system.shown["plan"] = json.dumps(
        {
            "say": "plan",
            "seq": seq,
            "stamp_us": 1,
            "paths": [{"arm": "PSM1", "points": WAY}],
            "note": "",
            "phase": "pulling",
            "confidence": 0.75,
            "keypoints": [{"name": "tip", "at": POINT, "certainty": 1.0}],
            "attention": None,
            "counts": {"accepted": 9, "clipped": 0, "rejected": 2, "late": 1, "stale": 0},
            "rule": "workspace",
            "text": "a depth of 300 mm",
            **changes,
        }
    )


async def centre(tab: Tab, red: str) -> list[float] | None:
    """Middle [share of the canvas] of the box of pixels of a colour; None: there are none."""
    script = f"""(() => {{
      const c = document.querySelector('#plan');
      const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
      let box = [1e9, 1e9, -1, -1];
      for (let i = 0; i < d.length / 4; i += 1) {{
        const [r, g, b, a] = d.subarray(4 * i, 4 * i + 4);
        if (a < 128 || !({red})) continue;
        const x = i % c.width, y = Math.floor(i / c.width);
        box = [Math.min(box[0], x), Math.min(box[1], y), Math.max(box[2], x), Math.max(box[3], y)];
      }}
      return box[2] < 0 ? null : [box[0], box[1], box[2] + 1, box[3] + 1, c.width, c.height];
    }})()"""
    found: Any = await tab.run(script)
    return None if found is None else [float(v) for v in found]


ORANGE, BLUE = "r > 200 && b < 90", "b > 200 && r < 90"


@within(150.0)
async def test_plan_and_points_stand_at_their_pixels_and_words_beside(tmp_path: Path) -> None:
    async with console() as made, Chromium() as browser:
        tab = await browser.open(made.url)
        await tab.until("surgConsole.picture.drawn.length > 3", "pictures", 60.0)
        button = "document.querySelector('[data-overlay=plan]').hidden"
        assert await tab.run(button), "no model server, no button"
        made.system.now = made.system.robot()
        running = PolicyServer("RUNNING", "image", "", "")
        made.system.now = type(made.system.now)(**{**vars(made.system.now), "policy": running})
        await tab.until(f"!{button}", "the button", 10.0)
        assert made.system.watched == frozenset(), "off by default"
        planned(made, 1)
        await tab.tap("KeyI")
        await when(lambda: made.system.watched == {"plan"}, "the socket", 10.0)
        await tab.until("surgConsole.plan.drawn > 0", "a plan", 20.0)

        # The way: from the first place to the last; its ends have dots of 2 and 4 px of 480.
        box = await centre(tab, ORANGE)
        assert box is not None
        width, height = box[4:]
        dot = height / 480
        expected = [
            0.25 * width - 2 * dot, 0.25 * height - 4 * dot,
            0.5 * width + 4 * dot, 0.5 * height + 2 * dot,
        ]  # fmt: skip
        np.testing.assert_allclose(box[:4], expected, atol=1.5)
        # A gap is a gap: nothing between the second place and the last.
        half = f"""(() => {{ const c = document.querySelector('#plan');
          return c.getContext('2d').getImageData({0.4375 * width}, {0.375 * height}, 1, 1)
          .data[3] }})()"""
        assert await tab.run(half) == 0
        # The point's ring: its left edge and lower edge, for its words are right and above.
        ring = await centre(tab, BLUE)
        assert ring is not None
        assert ring[0] == pytest.approx(0.75 * width - 7.75 * dot, abs=1.5)
        assert ring[3] == pytest.approx(0.75 * height + 7.75 * dot, abs=1.5)
        words = await tab.run("document.querySelector('#plan-note').innerText")
        for part in ("pulling, 75 % sure", "refused 2", "late 1", "workspace: a depth of 300"):
            assert part in words, words
        await tab.screenshot(Path(os.environ.get("SURG_SCREEN_SHOTS", tmp_path)) / "plan.png")

        # A map fills its area; work per plan, not per picture.
        data = base64.b64encode(bytes([255] * 4)).decode()
        area = [0.5, 0.0, 1.0, 0.5]
        planned(
            made, 2, paths=[], keypoints=[],
            attention={"rows": 2, "columns": 2, "area": area, "data": data},
        )  # fmt: skip
        await tab.until("surgConsole.plan.plan?.seq === 2", "the map", 10.0)
        sampled = """((x, y) => { const c = document.querySelector('#plan');
          return c.getContext('2d').getImageData(x * c.width, y * c.height, 1, 1).data[3] })"""
        assert await tab.run(f"{sampled}(0.75, 0.25)") > 60
        assert await tab.run(f"{sampled}(0.25, 0.25)") == 0
        drawn = await tab.run("surgConsole.plan.drawn")
        shown = await tab.run("surgConsole.picture.drawn.length")
        await asyncio.sleep(0.5)
        assert await tab.run("surgConsole.plan.drawn") == drawn
        assert await tab.run("surgConsole.picture.drawn.length") > shown + 3

        # A policy that falls silent has no plan any more.
        await tab.until("surgConsole.plan.plan === null", "silence", 10.0)
        assert await centre(tab, "true") is None
        # Side by side it stays in the left eye.
        await tab.tap("KeyB")
        await tab.until("surgConsole.plan.head.width > 600", "both eyes", 20.0)
        planned(made, 3)
        await tab.until("surgConsole.plan.plan?.seq === 3", "a plan", 10.0)
        box = await centre(tab, ORANGE)
        assert box is not None and box[2] == pytest.approx(0.25 * box[4] + 4 * dot, abs=2.0)
        await tab.tap("KeyI")
        await when(lambda: not made.system.watched, "the end", 10.0)
        assert await tab.run("document.querySelector('#plan').hidden")
        assert await tab.run("document.querySelector('#plan-note').hidden")
        assert browser.errors == [] and made.system.orders == []
