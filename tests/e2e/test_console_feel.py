"""The console's tone and rumble: off by default, as loud as the force, gone with what ends it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from collections.abc import AsyncIterator
from dataclasses import replace

import numpy as np
import pytest

from helpers.async_tests import within
from helpers.teleop import chromium
from helpers.teleop.chromium import GAMEPAD, Tab
from helpers.teleop.console import Console, drive, opened
from surg_console.session.tip_force_feedback import tip_force_feedback

pytestmark = pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing())

SOUND = """
window.heard = [];
window.rumbled = [];
const param = (name) => ({
  value: 0, cancelScheduledValues() {},
  setTargetAtTime(value, at) { window.heard.push([name, value, at]); },
  setValueAtTime(value, at) { window.heard.push([name, value, at]); },
});
window.AudioContext = class {
  get currentTime() { return window.soundTime ?? 0; }
  createOscillator() { return { frequency: param("pitch"), connect: (to) => to, start() {} }; }
  createGain() { return { gain: param("gain"), connect: (to) => to }; }
  close() { window.heard.push(["closed", 0, 0]); }
};
const plugged = window.plug;
window.plug = (axes, pressed) => {
  plugged(axes, pressed);
  window.pad.vibrationActuator = {
    playEffect(kind, effect) { window.rumbled.push([kind, effect]); return Promise.resolve(); },
    reset() { window.rumbled.push(["reset", {}]); },
  };
};
"""
"""A sound card and motors that keep account; `GAMEPAD` comes before."""
LOUDEST = "Math.max(...window.heard.filter(([n]) => n === 'gain').map(([, v]) => v))"
SOFT = 5.0
"""[N] The soft limit of the console's fake arm."""


@contextlib.asynccontextmanager
async def plugged() -> AsyncIterator[tuple[Console, Tab]]:
    """The page with a gamepad."""
    async with opened(GAMEPAD + SOUND) as (made, _, tab):
        await tab.run("(window.plug([0, 0, 0, 0], {}), 0)")
        await tab.until("surgConsole.hand.padName", "the pad", 20.0)
        yield made, tab


def push(made: Console, tip: float | None) -> None:
    made.system.now = replace(made.system.now, gauges=replace(made.system.now.gauges, tip=tip))


DRIVING = "surgConsole.status()?.phase === 'driving'"


async def recent(tab: Tab) -> None:
    """Forget what was heard, and hear for a while."""
    await tab.run("(window.heard.length = 0, window.rumbled.length = 0, 0)")
    await asyncio.sleep(0.5)


async def heard(made: Console, tab: Tab, volume: float) -> None:
    """Drive until the loudest of a while is a volume, and keep what was heard in that while."""
    near = f"Math.abs(({LOUDEST}) - {volume}) < 1e-6"
    forget = "(window.heard.length = 0, window.rumbled.length = 0, false)"

    async def found() -> bool:
        await drive(made, tab)
        return bool(await tab.run(f"({near}) || {forget}"))

    await chromium.until(found, f"a volume of {volume}", 20.0, period=0.5)


@within(120.0)
async def test_a_force_is_heard_and_rumbles_while_the_hand_moves_the_tip() -> None:
    async with plugged() as (made, tab):
        push(made, 2.5)
        await drive(made, tab)
        await recent(tab)
        assert await tab.run("window.heard.length + window.rumbled.length") == 0, "off"
        await tab.tap("KeyY")
        await heard(made, tab, 0.2 * 2.5 / SOFT)
        kind, effect = await tab.run("window.rumbled.at(-1)")
        assert kind == "dual-rumble" and effect["strongMagnitude"] == 2.5 / SOFT
        # Every piece ends by itself: a console that falls silent is not heard on.
        assert 0 < effect["duration"] <= 50
        gains = await tab.run("window.heard.filter(([n]) => n === 'gain')")
        assert gains[-1][1] == 0 and gains[-1][2] <= 0.05
        push(made, 50.0)
        await heard(made, tab, 0.2)  # at most
        for quiet in (None, 0.1):
            push(made, quiet)
            await heard(made, tab, 0.0)
            assert await tab.run("window.rumbled.at(-1)[0]") == "reset"
        push(made, 2.5)
        await tab.tap("Escape")
        await tab.until(f"!({DRIVING})", "the stop", 20.0)
        await recent(tab)
        assert await tab.run(LOUDEST) == 0, "nothing is felt of an arm that is not driven"
        await tab.tap("KeyY")
        assert await tab.run("window.heard.at(-1)[0]") == "closed"
        await recent(tab)
        assert await tab.run("window.heard.length") == 0


def last_heard(gains: list[list[float]]) -> float:
    """When a schedule of [value, from] ends in silence for good [s]."""
    assert gains[-1][0] == 0
    return gains[-1][1]


@within(120.0)
async def test_silence_is_felt_within_50_ms_of_a_forces_age() -> None:
    """On a made-up clock: ages and gaps drawn; the sound card plays on while the page is silent."""
    async with plugged() as (made, tab):
        made.system.shown["feel"] = json.dumps({"say": "feel", "tip": None, "age": None})
        await tab.tap("KeyY")
        await tab.until("window.rumbled.length > 0", "the first word", 20.0)
        await tab.run("(surgConsole.feel.mine = () => true, 0)")
        rng, now, loud = np.random.default_rng(5), 10.0, 0
        for _ in range(40):
            now += float(rng.uniform(0.001, 0.2))
            age = float(rng.choice([rng.uniform(0.0, 0.06), rng.uniform(0.0, 0.01)]))
            word = json.dumps({"say": "feel", "tip": 4.0, "age": age})
            heard, rumbled = await tab.run(
                "(window.heard.length = 0, window.rumbled.length = 0,"
                f" window.soundTime = {now}, surgConsole.feel.arrived({word}),"
                " [window.heard, window.rumbled])"
            )
            gains = [[value, at] for name, value, at in heard if name == "gain"]
            # The console looks every 10 ms, which an age does not hold.
            assert last_heard(gains) <= now + max(0.050 - 0.010 - age, 0.010) + 1e-9
            kind, effect = rumbled[-1]
            if gains[0][0] > 0:
                loud += 1
                assert kind == "dual-rumble" and effect["duration"] <= 1e3 * (0.040 - age)
            else:
                assert kind == "reset"
        assert 10 < loud < 40


@pytest.mark.parametrize(
    ("force", "age", "following", "told"),
    [
        (2.5, 0.002, True, 2.5),
        (2.5, 0.031, True, None),
        (2.5, 0.002, False, None),
        (None, 0.002, True, None),
        (2.5, math.inf, True, None),
    ],
)
def test_a_force_is_told_while_it_is_fresh_and_the_tip_follows(
    force: float | None, age: float, following: bool, told: float | None
) -> None:
    found = tip_force_feedback(force, 100.0 - age, 100.0, following)
    assert found["tip"] == told and found["age"] == pytest.approx(age)
