"""`./surg teleop` whole: phantom, controllers, recorder, teleoperation, console, and Chromium."""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.async_tests import within
from helpers.results.console_results import BY_FINGERS, BY_GAMEPAD, keeps, note
from helpers.teleop import chromium, steering, touch_drive
from helpers.teleop.chromium import GAMEPAD, Chromium, Tab, until
from helpers.teleop.keyboard_bgr import Player
from helpers.teleop.phantom import STILL, Phantom, phantom
from surg_cli.host import paths
from surg_core import load_cell
from surg_recording.episode import episode_reader
from surg_sim.physics.scene import ENDOSCOPE
from surg_sim.physics.world import World
from surg_sim.tasks.scripted_sender import home_frame

pytestmark = [
    pytest.mark.ros,
    pytest.mark.full,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]

TARGETS = 10
TOUCHED = 0.002
"""[m] from the tip to a target."""
TILTED = np.radians(10.0)
"""[rad] of the tool by a key."""


async def drive(tab: Tab) -> None:
    """Enable until the tip follows, by rate."""

    async def engaged() -> bool:
        if await tab.run("surgConsole.status()?.headline") == "Following":
            return True
        await tab.run("window.plug([0, 0, 0, 0], {9: 1})")  # Start
        await asyncio.sleep(0.1)
        await tab.run("window.plug([0, 0, 0, 0], {})")
        await asyncio.sleep(1.0)
        return False

    await until(engaged, "driving", 120.0)


async def push(tab: Tab, axes: np.ndarray, held: str = "{}") -> None:
    """Push the sticks: right, down, away in the picture, each from -1 to 1; buttons as well."""
    right, down, away = (float(np.sign(a) * np.sqrt(abs(a))) for a in np.clip(axes, -1, 1))
    # The page squares a stick beyond its dead zone of 0.12.
    stick = [np.sign(v) * (0.12 + 0.88 * abs(v)) if v else 0.0 for v in (right, down, away)]
    await tab.run(f"window.plug([{stick[0]}, {stick[1]}, 0, {-stick[2]}], {held})")


async def probe(made: Phantom, tab: Tab) -> np.ndarray:
    """(3, 3) tip velocities in the rcm frame for full sticks, one column per stick [m/s]."""
    columns = []
    for axis in np.eye(3):
        for sign in (0.5, -0.5):
            await push(tab, sign * axis)
            await asyncio.sleep(0.2)
            began, before = time.monotonic(), made.tip
            await asyncio.sleep(0.5)
            velocity = (made.tip - before) / (time.monotonic() - began) / sign
            columns.append(velocity)
            await push(tab, np.zeros(3))
            await asyncio.sleep(0.3)
    pairs = np.array(columns).reshape(3, 2, 3)
    return pairs.mean(axis=1).T


async def touch(made: Phantom, tab: Tab, J: np.ndarray, target: np.ndarray) -> float:
    """Steer until the tip is at a target; how long it took [s]."""
    began = time.monotonic()
    inverse = np.linalg.inv(J)
    while np.linalg.norm(target - made.tip) > TOUCHED:
        assert time.monotonic() - began < 60.0, (target, made.tip)
        if await tab.run("surgConsole.status()?.headline") != "Following":
            await drive(tab)
        await push(tab, inverse @ (1.5 * (target - made.tip)))
        await asyncio.sleep(0.05)
    await push(tab, np.zeros(3))
    return time.monotonic() - began


@within(900.0)
async def test_ten_targets_are_touched_and_recorded(tmp_path: Path) -> None:
    async with phantom(tmp_path, "sim_two_arms") as made, Chromium() as browser:
        tab = await browser.open(made.url, GAMEPAD)
        await tab.until("surgConsole.picture.drawn.length > 10", "pictures", 120.0)
        await tab.run("(window.plug([0, 0, 0, 0], {}), 0)")
        await tab.click('#hands [data-hand="rate"]')
        await drive(tab)
        await tab.tap("KeyV")
        await tab.until("surgConsole.status().record.on", "the recording", 60.0)
        J = await probe(made, tab)
        # Hand and picture agree: no stick has gone wrong, and all three are of one speed.
        speeds = np.linalg.norm(J, axis=0)
        assert speeds.min() > 0.5 * speeds.max() > 0.002, speeds
        rng = np.random.default_rng(5)
        home, took = made.tip, []
        for _ in range(TARGETS):
            target = home + rng.uniform(-0.012, 0.012, 3)
            took.append(await touch(made, tab, J, target))
        note(BY_GAMEPAD, TARGETS, took)
        await tab.tap("KeyV")
        await tab.until("!surgConsole.status().record.on", "the recorder's end", 60.0)
        await tab.until(
            "document.querySelector('#episodes .chip')?.innerText === 'aborted'",
            "the list: its task was not over",
        )
        await tab.run("(window.plug([0, 0, 0, 0], {1: 1}), 0)")
        await tab.until("document.body.dataset.phase === 'held'", "the stop")
        assert browser.errors == []
    recorded = episode_reader.read(tmp_path / "out" / "episode")
    assert recorded.complete, recorded.manifest["reason"]
    assert len(recorded.cycle("PSM1")) > 1000
    assert len(recorded.video("endoscope_left").frames) > 50


@within(600.0)
async def test_bgr_with_two_arms_and_two_hands_from_the_page(tmp_path: Path) -> None:
    """The hand on the instrument, then on the endoscope; another on the assistant's instrument."""
    camera = "{5: 1}"  # the right shoulder button
    headline = "surgConsole.status()?.headline"
    second = paths.ROOT / "tests" / "helpers" / "teleop" / "second_hand.py"
    more = ("--leader", "browser", "--leader", second)
    async with phantom(tmp_path, "sim_two_arms", *more) as made, Chromium() as browser:
        tab = await browser.open(made.url, GAMEPAD)
        await tab.until("surgConsole.picture.drawn.length > 10", "pictures", 120.0)
        await tab.until("surgConsole.status().task?.now.startsWith('Wait until')", "the task", 60.0)
        await tab.run("(window.plug([0, 0, 0, 0], {}), 0)")
        await tab.click('#hands [data-hand="rate"]')
        await drive(tab)
        await tab.tap("KeyV")
        await tab.until("surgConsole.status().record.on", "the recording", 60.0)

        # The instrument moves and the endoscope stands.
        lens, tip = made.lens[-1][1], made.tip
        await moved(made, tab, np.array([0.5, 0.0, 0.0]), "{}", made.tips, tip)
        assert np.linalg.norm(made.lens[-1][1] - lens) < 2e-4

        # The camera button: the endoscope moves and the instrument stands.
        await push(tab, np.zeros(3), camera)
        await tab.until(f"{headline} === 'Endoscope'", "the hand-over", 30.0)
        await asyncio.sleep(0.3)
        lens, tip = made.lens[-1][1], made.tip
        await moved(made, tab, np.array([0.0, 0.0, 0.5]), camera, made.lens, lens)
        assert np.linalg.norm(made.tip - tip) < 2e-4
        await push(tab, np.zeros(3))
        await tab.until(f"{headline} === 'Following'", "the way back", 30.0)
        await moved(made, tab, np.array([-0.5, 0.0, 0.0]), "{}", made.tips, made.tip)

        # The second hand has a line of its own, and moves by itself meanwhile.
        line = "[...document.querySelectorAll('#arms li')].at(-1).innerText"
        await tab.until(f"{line}.includes('assistant (second_hand)')", "the second hand")
        await tab.until(f"{line}.includes('FOLLOWING')", "it to follow", 30.0)
        await asyncio.sleep(6.0)
        await tab.screenshot(tmp_path / "console_bgr.png")
        await tab.tap("KeyV")
        await tab.until("!surgConsole.status().record.on", "the recorder's end", 60.0)
        assert browser.errors == []
    recorded = episode_reader.read(tmp_path / "out" / "episode")
    assert recorded.complete, recorded.manifest["reason"]
    for arm in ("PSM1", "ECM"):
        assert np.ptp(recorded.cycle(arm).vector("p_set"), axis=0).max() > 1e-3, arm
    state = recorded.table("task_state")
    ways = [np.ptp(state[f"task.assistant_joints_{i}"]) for i in range(4)]
    assert max(ways) > 0.02, "the assistant's instrument has moved"
    folder = os.environ.get("SURG_RESULTS_DIR")
    if folder:
        picture = Path(folder).parent / "pictures" / "console.png"
        picture.write_bytes((tmp_path / "console_bgr.png").read_bytes())


async def moved(
    made: Phantom,
    tab: Tab,
    axes: np.ndarray,
    held: str,
    places: list[tuple[float, np.ndarray]],
    start: np.ndarray,
) -> None:
    """Push until a tip is 3 mm from where it was, then let go; a busy machine may let go first."""
    began = time.monotonic()
    while np.linalg.norm(places[-1][1] - start) < 0.003:
        assert time.monotonic() - began < 60.0, (start, places[-1])
        headline = await tab.run("surgConsole.status()?.headline")
        if headline not in ("Following", "Endoscope"):
            await drive(tab)
        await push(tab, axes, held)
        await asyncio.sleep(0.05)
    await push(tab, np.zeros(3), held)
    await asyncio.sleep(0.3)


@within(400.0)
async def test_keys_tilt_a_wrist_as_the_picture_shows(tmp_path: Path) -> None:
    """8 up, 9 down, 7 left, 0 right, by the simulator's camera; the tip stays in its place."""
    cell = load_cell(paths.ROOT / "cells" / "sim_ur5e_wrist")
    world = World(cell, visuals=False)
    mujoco.mj_forward(world.model, world.data)
    R_WC = world.data.camera(ENDOSCOPE).xmat.reshape(3, 3)  # x right, y up, z to the viewer
    R_CR = R_WC.T @ home_frame(cell.arms["PSM1"])[:3, :3]
    async with phantom(tmp_path, "sim_ur5e_wrist") as made, Chromium() as browser:
        tab = await browser.open(made.url)
        await tab.until("globalThis.surgConsole?.picture.drawn.length > 10", "pictures", 120.0)
        await tab.tap("KeyM")
        player = Player(made, tab, cell)
        ways = {"Digit8": (1, 0), "Digit9": (-1, 0), "Digit7": (0, 1), "Digit0": (0, -1)}
        for code, way in ways.items():
            await player.enable()
            place, begun = made.tip, Rotation.from_quat(made.q).inv()

            async def turned(begun: Rotation = begun, code: str = code) -> list[float]:
                await player.enable()
                await player.hold(code)
                turn = R_CR @ (Rotation.from_quat(made.q) * begun).as_rotvec()
                return list(turn) if np.linalg.norm(turn) > TILTED else []

            turn = np.array(await until(turned, f"{code} to turn the tool", 60.0))
            await player.hold()
            await asyncio.sleep(0.3)
            print(f"{code}: {np.degrees(turn)} degrees, {made.tip - place} m")
            assert turn @ np.array([*way, 0]) > 0.98 * np.linalg.norm(turn)
            assert np.linalg.norm(made.tip - place) < TOUCHED
        assert browser.errors == []


@pytest.mark.parametrize("what", ["hidden", "frozen", "closed"])
@within(600.0)
async def test_the_arm_rests_when_the_tab_goes(what: str, tmp_path: Path) -> None:
    """From the event in the browser to the tip at rest, while it moved at 20 mm/s."""
    rests = []
    async with phantom(tmp_path, "sim_ur5e") as made, Chromium() as browser:
        for turn in range(6):
            tab = await browser.open(made.url, GAMEPAD)
            await tab.until("surgConsole.picture.drawn.length > 10", "pictures", 120.0)
            await tab.run("(window.plug([0, 0, 0, 0], {}), 0)")
            await tab.click('#hands [data-hand="rate"]')
            await drive(tab)
            before = made.tip
            await push(tab, np.array([0.5 * (-1) ** turn, 0, 0]))
            await asyncio.sleep(0.6)
            assert np.linalg.norm(made.tip - before) > 0.002
            began = time.monotonic()
            if what == "hidden":
                await browser.open("about:blank", ready=False)
            elif what == "closed":
                await tab.close()
            else:
                script = "(() => { const t = performance.now();"
                script += " while (performance.now() < t + 2000); })()"
                freezing = asyncio.create_task(tab.run(script))
            await asyncio.sleep(1.5)
            rests.append(made.rest_since() - began)
            if what == "frozen":
                await freezing
            if what != "closed":
                rest = made.tip
                await asyncio.sleep(0.5)  # awake again: nothing goes on
                assert np.linalg.norm(made.tip - rest) < STILL
                await tab.close()
    note(f"tip at rest, tab {what}", len(rests), rests)
    # The arm itself needs up to 50 ms more, from the order to hold to the rest.
    keeps(f"tip at rest, tab {what}", rests, (0.3 if what == "frozen" else 0.2) + 0.05)


@within(580.0)
async def test_ten_targets_are_touched_by_fingers(tmp_path: Path) -> None:
    async with phantom(tmp_path, "sim_two_arms") as made, Chromium() as browser:
        tab = await browser.open(made.url, screen=(1024, 768, True))
        await tab.until("globalThis.surgConsole?.picture.drawn.length > 10", "pictures", 120.0)

        async def move(by: np.ndarray) -> None:
            await touch_drive.move(made, tab, by)

        J = await steering.probe(made, move)
        steering.one_hand_frame(J)
        rng = np.random.default_rng(23)
        home, took = made.tip, []
        for _ in range(TARGETS):
            target = home + rng.uniform(-0.01, 0.01, 3)
            took.append(
                await steering.touch(made, lambda by: touch_drive.move(made, tab, by), J, target)
            )
            print(f"target {len(took)}: {took[-1]:.1f} s")
        note(BY_FINGERS, TARGETS, took)
        await tab.fingers("touchStart", await tab.middle("#stop"))
        await tab.fingers("touchEnd")
        await tab.until("document.body.dataset.phase === 'held'", "the stop", 20.0)
        assert browser.errors == []
