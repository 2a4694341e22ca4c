"""The label page in Chromium, by the keyboard alone."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import AsyncIterator, Sequence
from pathlib import Path

import pytest

from conftest import FULL
from helpers.recording import datasets_synthetic
from helpers.recording.recording_synthetic import TICK_NS
from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium, Tab
from surg_console.labelling.label_pages import LabelPages
from surg_console.labelling.label_server import LabelServer
from surg_recording.episode import episode_reader

pytestmark = [
    pytest.mark.untimed,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]

EPISODES = 20 if FULL else 3
BADGE = "document.getElementById('judged').textContent"


@contextlib.asynccontextmanager
async def opened(folders: Sequence[Path]) -> AsyncIterator[tuple[Chromium, Tab]]:
    server = LabelServer(LabelPages(folders, "A"))
    serving = asyncio.create_task(server.serve())
    try:
        async with Chromium() as browser:
            yield browser, await browser.open(server.url)
    finally:
        serving.cancel()
        await asyncio.wait([serving])


async def ready(tab: Tab, number: int, count: int) -> None:
    script = f"document.getElementById('place')?.textContent.startsWith('{number} of {count} ')"
    await tab.until(script, "the page", 60.0)


def test_the_keyboard_alone_labels_episodes(tmp_path: Path) -> None:
    """Verdict, stages, trim and note of the first; a verdict and one mark of the others."""
    first = datasets_synthetic.record(tmp_path / "e00", 0, 0.7)
    folders = [first]
    for n in range(1, EPISODES):
        folders.append(datasets_synthetic.copy(first, tmp_path / f"e{n:02d}", seed=n))

    async def label() -> None:
        async with opened(folders) as (browser, tab):
            await ready(tab, 1, EPISODES)
            begun = time.monotonic()
            await tab.type("f Home ArrowRight ArrowRight 1 ArrowRight ArrowRight 2")
            await tab.type("ArrowRight [ ArrowRight ArrowRight ArrowRight ] n a b Escape")
            await tab.until("document.getElementById('saved').textContent === 'saved'", "saving")
            await tab.until(f"{BADGE} === 'failure, verdicts disagree'", "the new verdict")
            if file := os.environ.get("SURG_TEST_PICTURES"):
                await tab.screenshot(Path(file) / "label.png")
            for number in range(2, EPISODES + 1):
                await tab.type("Enter")
                await ready(tab, number, EPISODES)
                assert await tab.run(BADGE) == "success"
                await tab.type("s Home ArrowRight 1 0 Backspace 2 9")
            await tab.until("document.getElementById('saved').textContent === 'saved'", "saving")
            print(f"{EPISODES} episodes in {time.monotonic() - begun:.1f} s")
            assert not browser.errors

    asyncio.run(asyncio.wait_for(label(), 240.0))
    found = episode_reader.read(first)
    given = found.manifest["labels"]
    stamps = found.video("endoscope_left").frames["stamp_ns"]
    assert (given["success"], given["note"], given["by"]) == (False, "ab", "A")
    begin = int(found.cycle("PSM1")["stamp_ns"][0])
    assert begin == TICK_NS
    marks = [s["begin_ns"] for s in given["stages"] if s["begin_ns"] in (stamps[1], stamps[3])]
    assert marks == [stamps[1], stamps[3]]
    assert given["trim"] == {"begin_ns": int(stamps[4]), "end_ns": int(stamps[7])}
    for folder in folders[1:]:
        assert episode_reader.read(folder).manifest["labels"]["success"] is True
