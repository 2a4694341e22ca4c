"""Recorded motions on the emulated UR: the pivot, an arm that does not move, one hash per seed.

Motion player, controller, link and robot in one thread on a made-up clock. ``SURG_TEST_FULL=1``
plays whole motions, and the one that SURG_TEST_MOTION names.
"""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest

from helpers.hardware.chain_player import Played, play, surgeon
from helpers.hardware.emulated_chain import Chain
from helpers.results import hardware_results as page
from surg_cli.host import paths
from surg_core import Law
from surg_teleop.playback.motion_player import PlayerStage

pytestmark = pytest.mark.untimed

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
GIVEN = os.environ.get("SURG_TEST_MOTION")
BUNDLED = paths.ROOT / "src/surg_teleop/motions/bundled.csv"
SECONDS = 40.0 if FULL else 2.0
"""Of a synthetic surgeon's motion."""
SEEDS = range(1, 4 if FULL else 2)
OFF, OFF_RECORDED = 0.1, 0.15
"""[mm] Largest deviation from the pivot; of a recording, whose accelerations nobody knows."""


def started(law: Law = Law.EXACT) -> Chain:
    """A chain whose robot a person has started."""
    chain = Chain(law, enabled=False)
    assert chain.start() == ""
    chain.run(20)
    return chain


def report(row: str, runs: list[Played], limit: float = OFF) -> None:
    """Note the deviation in these runs, and judge it."""
    for each in runs:
        assert each.stage is PlayerStage.DONE, each.reason
    means = [1e3 * float(each.deviation.mean()) for each in runs]
    most = 1e3 * max(float(each.deviation.max()) for each in runs)
    fastest = 1e3 * max(each.speed for each in runs)
    said = f"mean {max(means):.4f}, max {most:.3f} mm, tip up to {fastest:.0f} mm/s"
    page.note(row, len(runs), said)
    assert most <= limit


def test_a_surgeons_motion_keeps_the_pivot(tmp_path: Path) -> None:
    runs = [play(started(), surgeon(tmp_path, seed, SECONDS)) for seed in SEEDS]
    report(page.SURGEON, runs)


@pytest.mark.full
def test_the_bundled_motion_keeps_the_pivot() -> None:
    report(page.BUNDLED, [play(started(), BUNDLED)])


@pytest.mark.skipif(not GIVEN, reason="SURG_TEST_MOTION names a recording")
def test_a_recorded_motion_keeps_the_pivot() -> None:
    assert GIVEN is not None
    report(page.RECORDED, [play(started(), Path(GIVEN))], OFF_RECORDED)


UNMOVED = ("joint link", "twist link", "commands on a wrong topic")


@pytest.mark.parametrize("scale", [1.0, 0.1] if FULL else [0.1])
@pytest.mark.parametrize("which", UNMOVED)
def test_an_arm_that_does_not_move_never_plays_a_motion_to_its_end(
    which: str, scale: float
) -> None:
    """Its link says ACTIVE all the time. The operator's exit code is 0 without a reason only."""
    chain = started(Law.VELOCITY if which == "twist link" else Law.EXACT)
    if "topic" in which:
        chain.obeys_commands = False
    else:
        chain.moves = False
    played = play(chain, BUNDLED, scale)
    print(f"{which}, scale {scale}: {played.reason}")
    assert played.stage is PlayerStage.FAILED
    assert "not_following" in played.reason


def test_emulator_and_controller_with_one_seed_give_one_hash(tmp_path: Path) -> None:
    """A seeded motion, and a seeded protective stop in it."""
    hashes = set()
    for _ in range(2):
        chain, rng = started(), random.Random(7)
        stop = rng.randrange(900, 1100)

        def each(cycle: int, chain: Chain = chain, stop: int = stop) -> None:
            if cycle == stop:
                chain.robot.protective_stop("test")

        played = play(chain, surgeon(tmp_path, 7, 1.5), each=each)
        assert played.stage is PlayerStage.FAILED and "robot" in played.reason
        hashes.add(played.state_hash)
    assert len(hashes) == 1
    print(f"state hash {hashes.pop()[:16]}")
