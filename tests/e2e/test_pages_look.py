"""Every page as people see and hear it: four sizes, a light and a dark look, judged by axe-core."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest

from helpers.async_tests import within
from helpers.recording import datasets_synthetic
from helpers.recording.evaluated import DONE, episode
from helpers.results.screen_results import Looks
from helpers.teleop import axe, chromium
from helpers.teleop.axe import (
    LOOKS,
    SIZES,
    contrast,
    grave,
    resize,
    scrolls_sideways,
    spoken,
    visible,
)
from helpers.teleop.chromium import Chromium, Tab
from helpers.teleop.console import Console, console, opened
from surg_console.labelling.label_pages import LabelPages
from surg_console.labelling.label_server import LabelServer
from surg_console.session.episode_list import Entry
from surg_console.session.system_state import Recorder, SimTask
from surg_recording.episode import episode_reader
from surg_recording.reports import episode_view, evaluation, evaluation_report

pytestmark = [
    pytest.mark.untimed,
    pytest.mark.skipif(
        bool(chromium.missing() or axe.missing()), reason=chromium.missing() or axe.missing()
    ),
]

BUSY = Entry("episode_2", 2.0, 34.2, "complete", "failure", "lost", "task")
"""A recording that nobody has judged yet."""
PAGES = ("", "monitor", "headset", "calibrate")
STOPS = ("", "monitor", "headset")
"""Pages that can stop an arm."""
FOUND = Looks()
TEXT = 4.5
"""Least contrast of a text."""
ZOOMS = (2, 4)
BOXES = """[...document.querySelectorAll('#videos video')].map(
  (video) => [video.clientWidth, video.parentElement.clientWidth])"""
"""Widths of the videos of an episode's page and of their boxes."""
WORDS = "[...document.querySelectorAll('#judged, #verdict')].map((each) => each.textContent)"
"""Where such a page says how the episode ended."""


def play(made: Console) -> None:
    """A task runs, and a recording has stopped: the console shows all that it can."""
    task, recorder = SimTask("RUNNING", "bgr", "grasp"), Recorder("IDLE", "", "/runs/1/episode_2")
    made.system.now = replace(made.system.now, task=task, recorder=recorder)
    made.system.episodes = [BUSY, Entry("episode", 1.0, 3.0, "incomplete", "aborted", "disk")]


async def judge(tab: Tab, page: str, where: str) -> None:
    """No grave fault, and every text can be read."""
    assert await grave(tab) == [], (page, where)
    texts, least = await contrast(tab)
    assert texts and least >= TEXT, (page, where, least)
    FOUND.add(page, where, texts, least)


async def each_look(tab: Tab, full: bool, check: Callable[[str], Awaitable[None]]) -> None:
    """Call a check in every size and look; in a short run, in the narrowest and the widest."""
    every = [(width, look) for width in SIZES for look in LOOKS]
    for width, look in every if full else (every[0], every[-1]):
        await resize(tab, width, look=look)
        await check(f"{width} px, {look}")


@within(400.0)
async def test_the_pages_have_no_grave_fault_and_stop_stays(full: bool) -> None:
    async with console() as made, Chromium() as browser:
        play(made)
        for page in PAGES:
            tab = await browser.open(made.url + page)
            if not page:
                await tab.until("!document.querySelector('#judge').hidden", "the bars", 60.0)

            async def check(where: str, tab: Tab = tab, page: str = page) -> None:
                await judge(tab, page or "console", where)
                assert not await scrolls_sideways(tab), (page, where)
                if page in STOPS:
                    assert await visible(tab, "#stop"), (page, where)
                for shown in () if page else ("h1", "#cell", "#task", "#link", "#control"):
                    assert await visible(tab, shown), (shown, where)

            await each_look(tab, full, check)
            for zoom in ZOOMS:
                await resize(tab, 1366 // zoom, 768 // zoom)
                await tab.run("document.querySelectorAll('*').forEach((e) => e.scrollTo(0, 9e9))")
                assert page not in STOPS or await visible(tab, "#stop"), (page, zoom)
            await tab.close()
        assert browser.errors == []


@within(400.0)
async def test_held_fault_and_lost_are_announced_and_the_end_is_said(full: bool) -> None:
    async with Chromium() as browser:
        async with console() as made:
            play(made)
            tab = await browser.open(made.url)
            await tab.until("surgConsole.picture.drawn.length > 3", "pictures", 60.0)
            assert not any(await spoken(tab, "alert"))
            await tab.tap("Escape")
            await tab.until("!document.querySelector('#veil').hidden", "the veil")

            async def check(where: str) -> None:
                assert await grave(tab) == [], where
                assert await visible(tab, "#stop"), where

            await each_look(tab, full, check)
            assert any(
                text.startswith("Held. Stop was pressed") for text in await spoken(tab, "alert")
            )
            arms = tuple(replace(arm, state="FAULT") for arm in made.system.now.arms)
            made.system.now = replace(made.system.now, arms=arms)
            alarm = "document.querySelector('#alarm').textContent"
            await tab.until(f"{alarm}.startsWith('Fault. ')", "the fault")
            assert any(text.startswith("Fault. ") for text in await spoken(tab, "alert"))
        text = "document.querySelector('#sentence').innerText"
        again = "Start it again in its terminal: ./surg teleop test_cell."
        await tab.until(f"{text}.includes({again!r})", "the end", 60.0)
        await asyncio.sleep(1.5)  # the page tries to connect meanwhile
        assert again in await tab.run(text)
        assert any(again in text for text in await spoken(tab, "alert"))
        words = await tab.run("document.body.innerText")
        assert "have control" not in words and "arm holds" not in words
        assert await tab.run("document.querySelector('main').inert")
        assert await tab.run("document.querySelector('#rcm b').innerText") == "–"
        assert await grave(tab) == []


@within(240.0)
async def test_each_tab_knows_its_number_and_the_help_gives_the_focus_back(full: bool) -> None:
    async with console() as made, Chromium() as browser:
        tab = await browser.open(made.url)
        control = "document.querySelector('#control').innerText"
        await tab.until(f"{control} === 'Page 1: you have control'", "the first")
        other = await browser.open(made.url)
        await other.until(f"{control} === 'Page 2: page 1 has control'", "the second")
        assert await other.run("document.title") == "Page 2 · Operator console"

        focus = "document.activeElement.id"
        await tab.run("document.querySelector('#speed').focus(), 0")
        await tab.key("Slash", True, "?")
        await tab.key("Slash", False, "?")
        assert await tab.run(focus) == "help-close"
        await resize(tab, 1366)
        box = "document.querySelector('#help')"
        assert await tab.run(f"{box}.scrollHeight <= {box}.clientHeight"), "it fits 768 px"

        async def check(where: str) -> None:
            await judge(tab, "help", where)
            assert await visible(tab, "#stop"), where

        await each_look(tab, full, check)
        links = await tab.run("[...document.querySelectorAll('#help a')].map((a) => a.pathname)")
        assert links == ["/monitor", "/headset", "/calibrate"]
        await tab.tap("Slash")
        assert await tab.run(f"{box}.hidden") and await tab.run(focus) == "speed"
        assert browser.errors == []


@within(240.0)
async def test_what_is_drawn_keeps_its_shape_and_the_key_bar_wraps() -> None:
    async with opened() as (_, _, tab):
        for width in (820, 1366):
            await resize(tab, width)
            trend = "document.querySelector('#trend')"
            await tab.until(f"{trend}.width === {trend}.clientWidth", "the sparkline")
            assert await tab.run(f"{trend}.height === {trend}.clientHeight")
        keys = "document.querySelector('#keys')"
        assert await tab.run(f"{keys}.scrollWidth <= {keys}.clientWidth")
        assert await tab.run(f"getComputedStyle({keys}).flexWrap") == "wrap"
        assert await visible(tab, "#keys > :last-child")
        shade = "getComputedStyle(document.querySelector('#age')).backgroundColor"
        assert await tab.run(shade) == "rgba(4, 6, 8, 0.8)", (
            "age and rate stand on their own ground"
        )


@within(240.0)
async def test_one_eye_is_enough_for_the_monitor_and_a_command_names_its_cell() -> None:
    async with console(facts={"views": ["left"]}) as made, Chromium() as browser:
        tab = await browser.open(f"{made.url}monitor")
        await tab.until("surgMonitor.picture.drawn.length > 2", "the left eye", 60.0)
        assert {layout for layout, _ in made.camera.wanted} == {"left"}
        alarm = "document.querySelector('#alarm').textContent"
        await tab.until(f"{alarm}.startsWith('HOLD · No one has control')", "the cause")
        other = await browser.open(f"{made.url}calibrate")
        hint = "document.querySelector('#hint').innerText"
        await other.until(f"{hint}.includes('./surg calibrate test_cell live')", "the command")
        assert browser.errors == []


@within(400.0)
async def test_label_view_and_report_fit_a_phone_and_a_large_zoom(
    full: bool, tmp_path: Path
) -> None:
    folder = datasets_synthetic.record(tmp_path / "e", 1, 0.7)
    page = episode_view.write(episode_reader.read(folder), tmp_path / "view.html")
    made = episode(tmp_path / "judged", 2, task=DONE, setting="phantom")
    entries = [evaluation.measure(episode_reader.read(made))]
    summary = evaluation.summarise(
        entries, [], "reference", None, {"versions": {}, "paper_values": False}
    )
    evaluation_report.write(summary, tmp_path / "out")
    server = LabelServer(LabelPages([folder], "A"))
    serving = asyncio.create_task(server.serve())
    try:
        async with Chromium() as browser:
            report = (tmp_path / "out" / "report.html").as_uri()
            urls = {"label": server.url, "view": page.as_uri(), "report": report}
            for name, url in urls.items():
                tab = await browser.open(url)

                async def check(where: str, tab: Tab = tab, name: str = name) -> None:
                    await judge(tab, name, where)
                    assert not await scrolls_sideways(tab), (name, where)

                await each_look(tab, full, check)
                await resize(tab, 683, 384)
                assert await grave(tab) == [] and not await scrolls_sideways(tab), "zoom 200 %"
                for video, box in await tab.run(BOXES):
                    assert video == box, "the video fills its box"
                assert len(set(await tab.run(WORDS))) <= 1, "one verdict, one word"
                await tab.close()
    finally:
        serving.cancel()
        await asyncio.wait([serving])
