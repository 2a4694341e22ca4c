"""The policy's button of the operator console: in a browser, with a system that obeys."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium, until
from helpers.teleop.console import Console, console
from surg_console.session.console_orders import EnableTeleop, Policy
from surg_console.session.system_state import PolicyServer

pytestmark = pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing())


def say(made: Console, state: str) -> None:
    """The model server says its state."""
    made.system.now = replace(made.system.now, policy=PolicyServer(state, "Circle"))


async def press_and_look(picture: Path) -> None:
    """The button comes with the server, gives the arm away, and takes it back."""
    async with console() as made, Chromium() as browser:
        tab = await browser.open(made.url)
        await tab.until("surgConsole.picture.drawn.length > 3", "pictures", 60.0)
        shown = "!document.querySelector('#policy').hidden"
        assert not await tab.run(shown), "no server, no button"
        say(made, "IDLE")
        await tab.until(f"{shown} && document.querySelector('#policy').disabled", "the button")
        say(made, "READY")
        await tab.until("!document.querySelector('#policy').disabled", "a policy")
        await tab.click("#policy")

        async def given() -> bool:
            return Policy(True) in made.system.given(Policy)

        await until(given, "the arm to be given", 10.0)
        assert EnableTeleop(False) in made.system.given(EnableTeleop), "the hand let go first"
        say(made, "RUNNING")
        await tab.until(
            "document.querySelector('#sentence').textContent.includes('Enable takes it back')",
            "the sentence",
        )
        pressed = await tab.run("document.querySelector('#policy').getAttribute('aria-pressed')")
        assert pressed == "true"
        await tab.screenshot(picture)
        await tab.tap("KeyP")

        async def taken() -> bool:
            return made.system.given(Policy)[-1] == Policy(False)

        await until(taken, "the arm to be taken back", 10.0)
        assert browser.errors == []


def test_the_button_gives_the_arm_to_the_policy_and_takes_it_back(tmp_path: Path) -> None:
    asyncio.run(asyncio.wait_for(press_and_look(tmp_path / "policy.png"), 240.0))
