"""One person alone finishes `bgr` at the console, by the keyboard, with the scripted assistant."""

from __future__ import annotations

import asyncio
import contextlib
import os
from pathlib import Path

import pytest

from helpers.async_tests import within
from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium, Tab, until
from helpers.teleop.keyboard_bgr import Player
from helpers.teleop.phantom import phantom
from surg_cli.host import paths
from surg_core import load_cell
from surg_recording.episode import episode_reader
from surg_recording.episode.verdicts import verdict

pytestmark = [
    pytest.mark.ros,
    pytest.mark.full,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]

SEEDS = 3
"""Episodes one after the other, each begun from the page."""
JUDGED = ("success", "failure", "discard")
"""What the person says of each, by the keys 1, 2 and 3."""


AGAIN_S = 10.0
"""[s] After which a person presses a key again: a machine that is busy refuses what comes late."""


async def press(tab: Tab, code: str, wanted: str, what: str) -> None:
    """Press a key until the page says what it is for."""

    async def said() -> bool:
        await tab.tap(code)
        with contextlib.suppress(AssertionError):
            return bool(await tab.until(wanted, what, AGAIN_S))
        return False

    await until(said, what, 120.0)


@within(1500.0)
async def test_three_episodes_are_played_recorded_and_judged_by_keys(tmp_path: Path) -> None:
    shots = Path(os.environ.get("SURG_SHOTS", tmp_path))
    cell = load_cell(paths.ROOT / "cells" / "sim_two_arms")
    async with phantom(tmp_path, "sim_two_arms", of=("task",)) as made, Chromium() as browser:
        tab = await browser.open(made.url)
        await tab.until("globalThis.surgConsole?.picture.drawn.length > 10", "pictures", 240.0)
        bar = "document.querySelector('#task').innerText"
        await tab.until(f"{bar}.includes('Grasp the bowel where the assistant points')", "it", 60.0)
        await tab.until(f"{bar}.includes('Now: Wait until the assistant points')", "now", 60.0)
        await tab.tap("Digit1")  # nothing has been recorded
        toast = "document.querySelector('#toast').innerText"
        await tab.until(f"{toast}.includes('nothing to judge')", "the refusal")
        await tab.tap("KeyM")
        player = Player(made, tab, cell)
        for seed in range(SEEDS):
            await press(tab, "KeyV", "surgConsole.status().record.on", "the recording")
            await player.enable()
            if seed == 0:
                await player.probe()
            await player.play()
            await tab.until(f"{bar}.includes('Success after ')", "the end", 60.0)
            assert player.seen["seed"] == seed and player.seen["success"]
            await tab.screenshot(shots / f"bgr_{seed}.png")
            asked = "!document.querySelector('#judge').hidden"
            # "Not on" alone may be a status that is late on a busy machine.
            ends = f"surgConsole.status().record.finishing || {asked}"
            await press(tab, "KeyV", ends, "the recording's end")
            await tab.until(asked, "the question", 120.0)
            await press(tab, f"Digit{seed + 1}", f"!({asked})", "the judgement")
            if seed + 1 < SEEDS:
                await press(tab, "KeyG", f"{bar}.includes('Now: ')", "a new episode")
                await asyncio.sleep(0.2)
        first, second, third = (made.out / name for name in ("episode", "episode_2", "episode_3"))

        async def discarded() -> bool:
            return (third / "discarded.json").is_file()

        await until(discarded, "the discarded episode", 30.0)
        assert browser.errors == []
    for folder, word in zip((first, second), JUDGED[:2], strict=True):
        recorded = episode_reader.read(folder)
        assert recorded.complete, recorded.manifest["reason"]
        assert (verdict(recorded.manifest).outcome, verdict(recorded.manifest).by) == (
            word,
            "person",
        )
    assert [episode_reader.read(f).manifest["run"]["seed"] for f in (first, second)] == [0, 1]
    assert episode_reader.below(made.out) == [first, second]
