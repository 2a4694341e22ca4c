"""The policy's button of the operator console: in a browser, with a system that obeys."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from helpers.async_tests import within
from helpers.teleop import chromium
from helpers.teleop.console import Console, opened
from helpers.teleop.console_page import when
from surg_console.session.console_orders import EnableTeleop, Policy
from surg_console.session.system_state import PolicyServer

pytestmark = pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing())


def say(made: Console, state: str) -> None:
    """The model server says its state."""
    made.system.now = replace(made.system.now, policy=PolicyServer(state, "Circle"))


@within(240.0)
async def test_the_button_gives_the_arm_to_the_policy_and_takes_it_back(tmp_path: Path) -> None:
    """The button comes with the server, gives the arm away, and takes it back."""
    async with opened() as (made, _, tab):
        shown = "!document.querySelector('#policy').hidden"
        assert not await tab.run(shown), "no server, no button"
        say(made, "IDLE")
        await tab.until(f"{shown} && document.querySelector('#policy').disabled", "the button")
        say(made, "READY")
        await tab.until("!document.querySelector('#policy').disabled", "a policy")
        await tab.click("#policy")
        await when(lambda: Policy(True) in made.system.given(Policy), "the arm to be given", 10.0)
        assert EnableTeleop(False) in made.system.given(EnableTeleop), "the hand let go first"
        say(made, "RUNNING")
        await tab.until(
            "document.querySelector('#sentence').textContent.includes('Enable takes it back')",
            "the sentence",
        )
        pressed = await tab.run("document.querySelector('#policy').getAttribute('aria-pressed')")
        assert pressed == "true"
        await tab.screenshot(tmp_path / "policy.png")
        await tab.tap("KeyP")
        taken = lambda: made.system.given(Policy)[-1] == Policy(False)  # noqa: E731
        await when(taken, "the arm to be taken back", 10.0)
