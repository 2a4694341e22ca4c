"""Drives a whole running system by a headset that is not there."""

from __future__ import annotations

import asyncio
from collections import Counter

from helpers.teleop.chromium import Tab, until
from helpers.teleop.headset_page import SQUEEZE, A, hold

HEADLINE = "surgHeadset.status()?.headline"


async def squeezed(tab: Tab, hand: str, wanted: str) -> None:
    """Enable where needed, let all go, squeeze: until the page says what follows.

    Raises:
        AssertionError: It does not come; names what the page said instead.
    """
    said: Counter[str] = Counter()

    async def follows() -> bool:
        for other in ("left", "right"):
            await hold(tab, other, SQUEEZE, 0)
        if await tab.run("surgHeadset.status()?.phase") != "driving":
            await hold(tab, "right", A, 1)
            await asyncio.sleep(0.2)
            await hold(tab, "right", A, 0)
            await asyncio.sleep(1.5)
        await hold(tab, hand, SQUEEZE, 1)
        await asyncio.sleep(0.5)
        headline, sentence = await tab.run(f"[{HEADLINE}, surgHeadset.status()?.sentence]")
        said[f"{headline}: {sentence}"] += 1
        return bool(headline == wanted)

    try:
        await until(follows, f"{hand}: {wanted}", 120.0, 0.1)
    except AssertionError as error:
        raise AssertionError(f"{error}; the page said {said.most_common()}") from None
