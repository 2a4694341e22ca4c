"""The page /headset on Meta's own WebXR emulator, which is not ours."""

from __future__ import annotations

import pytest

from helpers.async_tests import within
from helpers.teleop import chromium, headset_page, iwer
from surg_console.session.console_session import Phase
from surg_console.session.operator_messages import HIDDEN

pytestmark = [
    pytest.mark.oracle,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]


@within(200.0)
async def test_the_headset_drives_on_an_emulated_quest() -> None:
    async with headset_page.entered(before=iwer.script()) as (made, tab):
        await headset_page.drives(made, tab, pulses=False)
        for act, why in (("show('hidden')", "headset"), ("device.recenter()", "recentred")):
            await headset_page.squeezed(made, tab)
            await tab.run(f"fakeXR.{act}, 0")
            held = lambda: headset_page.holds(made)  # noqa: E731
            await chromium.until(held, why, 20.0)
            assert made.session.reason == HIDDEN[why]
            assert made.session.phase is Phase.HELD
            await tab.run("fakeXR.show('visible')")
