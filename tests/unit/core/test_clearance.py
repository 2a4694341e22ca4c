"""The clearance guard: two arms, table and patient keep their distance, judged by MuJoCo.

``SURG_TEST_FULL=1`` runs 10^5 motions in ten parts.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

import surg_core
from helpers.control.capsule_scene import CapsuleScene
from helpers.control.two_arms import GuardedArm, RandomMotion, started, tick
from surg_cli.host import paths
from surg_core import ClearanceSetup, Motion, MotionCommand, OtherArm, Reason
from surg_core._core import Document, parse_cell

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
MOTIONS = 10_000 if FULL else 200
PARTS = range(10) if FULL else range(2)
CELLS = ("sim_two_arms", "sim_two_arms_panda")
MOVING = (Reason.NONE, Reason.UNREACHABLE)
Array = NDArray[np.float64]


def obstacles(cell: surg_core.Cell) -> tuple[surg_core.Obstacle, ...]:
    """A patient round the work point and a table below it, made as a cell would state them."""
    arm = cell.arms["PSM1"]
    X_BF = np.asarray(arm.chain.forward(arm.robot.home))
    tip = X_BF[:3, :3] @ np.asarray(arm.tool.p_FTip) + X_BF[:3, 3]
    values = {
        "format": "surg_cell/1", "name": "test", "network": "loopback",
        "arms.A.robot": "a", "arms.A.instrument": "b", "arms.A.link": "simulator",
        "arms.A.base.xyz": [0.0] * 3, "arms.A.base.rpy": [0.0] * 3,
        "clearance.obstacles.patient.from": (tip + np.array([0.0, 0.2, -0.03])).tolist(),
        "clearance.obstacles.patient.to": (tip - np.array([0.0, 0.2, 0.03])).tolist(),
        "clearance.obstacles.patient.radius": 0.1,
        "clearance.obstacles.table.point": (tip - [0.0, 0.0, 0.12]).tolist(),
        "clearance.obstacles.table.normal": [0.0, 0.0, 1.0],
    }  # fmt: skip
    return tuple(parse_cell(Document("cell.yaml", values)).clearance.obstacles)


def setups(
    cell: surg_core.Cell, distance: float, bodies: tuple[surg_core.Obstacle, ...] = ()
) -> list[ClearanceSetup]:
    """The setups of both arms."""
    made = [surg_core.clearance_setup(cell, name) for name in cell.arms]
    assert all(setup is not None for setup in made)
    return [ClearanceSetup(distance, 0.0, s.own, list(s.others), list(bodies)) for s in made if s]


# --- distances ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CELLS)
def test_distances_are_those_of_mujoco(name: str) -> None:
    cell = surg_core.load_cell(paths.ROOT / "cells" / name)
    arms, bodies = list(cell.arms.values()), obstacles(cell)
    first, second = setups(cell, 0.02, bodies)
    scene = CapsuleScene(arms, bodies)
    rng = np.random.default_rng(3)
    worst, apart = 0.0, 0
    for _ in range(500):
        q = [np.asarray(a.robot.home) + rng.normal(0.0, 0.4, a.chain.dof) for a in arms]
        ours = min(
            setup.closest(q[i], [OtherArm(q[1 - i], 0 * q[1 - i])])[0]
            for i, setup in enumerate((first, second))
        )
        theirs = scene.distance(*q)
        if theirs <= 0.0 or theirs >= 0.5:  # MuJoCo's penetration depth is another quantity
            assert (ours <= 1e-9) == (theirs <= 0.0)
            continue
        apart += 1
        worst = max(worst, abs(ours - theirs))
    print(f"{name}: {apart} of 500 postures apart, largest difference {1e6 * worst:.3f} um")
    assert apart > 100
    assert worst < 1e-6


# --- random motion --------------------------------------------------------------------------------


@dataclass
class Tally:
    """What came of many motions."""

    motions: int = 0
    ticks: int = 0
    limited: int = 0
    least: float = np.inf  # distance less the cell's [m]
    closest: int = -1  # start of that
    starts: int = 0
    paused: int = 0  # starts that ended in PAUSED(not_following)


def drawn(
    cell: surg_core.Cell, seed: int, start: int, guarded: bool = True
) -> tuple[CapsuleScene, float, list[GuardedArm], list[RandomMotion]]:
    """Start number ``start``, from [seed, start] alone: judge, distance [m], arms, senders."""
    rng = np.random.default_rng([seed, start])
    arms = list(cell.arms.values())
    bodies = obstacles(cell) if rng.integers(2) else ()
    judge = CapsuleScene(arms, bodies)
    free = judge.distance(*(np.asarray(arm.robot.home) for arm in arms))
    distance = float(np.clip(free - rng.uniform(0.004, 0.04), 0.005, 0.2))
    both = setups(cell, distance, bodies)
    pair = started(arms, list(both) if guarded else [None, None])
    return judge, distance, pair, [RandomMotion(arm, rng) for arm in pair]


def play(name: str, seed: int, motions: int, guarded: bool = True) -> Tally:
    """Random motions of both arms; every few motions another start and another distance."""
    cell = surg_core.load_cell(paths.ROOT / "cells" / name)
    tally = Tally()
    while tally.motions < motions:
        judge, distance, pair, senders = drawn(cell, seed, tally.starts, guarded)
        apart, paused = 0.0, False
        for k in range(3000):
            tick(pair, [[] if paused else sender.commands(k) for sender in senders], guarded)
            tally.limited += sum(arm.out.limited_by == "clearance" for arm in pair)
            if apart < distance + 0.003 or k % 5 == 0:
                apart = judge.distance(*(arm.q for arm in pair))
                if apart - distance < tally.least:
                    tally.least, tally.closest = apart - distance, tally.starts
            tally.ticks += 1
            paused = any(arm.out.state != surg_core.State.ENABLED for arm in pair)
            if paused and all(np.abs(arm.qd).max() < 1e-6 for arm in pair):
                break
        # A sharp turn at full speed may take a Panda 10 mm off its path.
        assert {arm.out.reason for arm in pair} - {Reason.NOT_FOLLOWING} <= {*MOVING}
        tally.paused += paused
        tally.motions += sum(sender.motions for sender in senders)
        tally.starts += 1
    return tally


@pytest.mark.parametrize("part", PARTS)
def test_random_motions_never_come_closer_than_the_cell_says(part: int) -> None:
    tally = play(CELLS[part % 2], 100 + part, MOTIONS)
    print(
        f"part {part}: {tally.motions} motions, {tally.ticks} ticks, limited in "
        f"{50 * tally.limited / tally.ticks:.1f} %; smallest distance "
        f"{1e3 * tally.least:+.3f} mm of the cell's (start {tally.closest}); "
        f"{tally.paused} of {tally.starts} starts paused"
    )
    assert tally.limited > 0.01 * tally.ticks
    assert tally.least > 0.0
    assert tally.paused <= 0.02 * tally.starts


def test_an_arm_of_small_accelerations_stays_on_its_path_while_it_moves() -> None:
    # A sharp turn once took the Panda 9 mm off its path. What is left is its lag.
    cell = surg_core.load_cell(paths.ROOT / "cells" / CELLS[1])
    _, _, pair, senders = drawn(cell, 101, 99)
    off, speed = [], []
    for k in range(1660):
        tick(pair, [sender.commands(k) for sender in senders])
        off.append(float(np.linalg.norm(np.asarray(pair[0].out.p_set) - pair[0].out.p_BTip)))
        speed.append(np.abs(pair[0].qd).max())
    print(f"{1e3 * max(off):.2f} mm off, {1e3 * max(off[1500:]):.2f} mm after the turn")
    assert max(off) < 3e-3
    assert min(speed[1620:]) > 0.3


def test_without_a_guard_the_same_motions_come_closer() -> None:
    assert play(CELLS[0], 100, 100, guarded=False).least < -0.005


# --- single motions -------------------------------------------------------------------------------

HOLD = [MotionCommand(Motion.HOLD, 1)]


def towards(pair: list[GuardedArm], i: int, sign: float, speed: float = 0.1) -> list[MotionCommand]:
    """A tip velocity that brings arm i to the other one (1.0) or away from it (-1.0)."""
    own, other = pair[i], pair[1 - i]
    R_WB = np.asarray(own.arm.X_WB)[:3, :3]
    R_BR = np.asarray(own.controller.X_BR)[:3, :3]
    to_world = np.asarray(other.arm.X_WB)[:3, 3] - np.asarray(own.arm.X_WB)[:3, 3]
    across = R_BR.T @ R_WB.T @ to_world
    across[2] = 0.0
    # The arm outside swings against the tip inside.
    return [MotionCommand(Motion.SERVO_CV, 1, p=-sign * speed * across / np.linalg.norm(across))]


def run(pair: list[GuardedArm], ticks: int, signs: tuple[float, float]) -> float:
    """Both arms towards (1.0), away (-1.0) or at rest (0.0); the smallest distance [m]."""
    least = np.inf
    for _ in range(ticks):
        asked = [towards(pair, i, sign) if sign else [] for i, sign in enumerate(signs)]
        tick(pair, asked)
        least = min(least, pair[0].out.clearance)
    return least


@pytest.fixture(name="two")
def _two() -> surg_core.Cell:
    return surg_core.load_cell(paths.ROOT / "cells" / CELLS[0])


def test_two_arms_that_meet_stop_and_can_both_leave(two: surg_core.Cell) -> None:
    distance = 0.05
    pair = started(list(two.arms.values()), list(setups(two, distance)))
    assert run(pair, 1500, (1.0, 1.0)) > distance
    assert all(arm.out.limited_by == "clearance" for arm in pair)
    assert all(np.abs(arm.out.qd_command).max() < 1e-3 for arm in pair)
    assert pair[0].out.clearance < distance + 0.004
    for first in (0, 1):  # either may leave while the other goes on pushing
        before = pair[0].out.clearance
        signs = (-1.0, 1.0) if first == 0 else (1.0, -1.0)
        for _ in range(100):
            assert run(pair, 1, signs) > distance
            assert pair[first].out.limited_by != "clearance", "away is not limited"
        assert pair[0].out.clearance > before + 0.003
        assert run(pair, 1000, (1.0, 1.0)) > distance


def test_an_arm_that_starts_too_close_only_moves_away(two: surg_core.Cell) -> None:
    close = CapsuleScene(list(two.arms.values())).distance(
        *(np.asarray(arm.robot.home) for arm in two.arms.values())
    )
    pair = started(list(two.arms.values()), list(setups(two, close + 0.02)))
    assert run(pair, 300, (1.0, 1.0)) > close - 1e-6
    assert all(np.abs(arm.qd).max() < 1e-9 for arm in pair)
    assert all(arm.out.reason == Reason.UNREACHABLE for arm in pair)
    run(pair, 300, (-1.0, 0.0))
    assert pair[0].out.clearance > close + 0.01


def test_without_the_other_arms_state_only_away_is_left(two: surg_core.Cell) -> None:
    pair = started(list(two.arms.values()), list(setups(two, 0.02)))
    own, seen = pair[0], pair[1].state()

    def go(sign: float, others: list[OtherArm]) -> float:
        for _ in range(200):
            own.step(towards(pair, 0, sign), others)
            own.obey(own.out.qd_command)
        return float(np.linalg.norm(own.out.v_BTip))

    assert go(1.0, []) < 1e-6
    assert (own.out.limited_by, own.out.reason) == ("clearance", Reason.OTHER_ARM_LOST)
    old = OtherArm(np.asarray(pair[1].q), np.asarray(pair[1].qd), 0.2)
    assert go(1.0, [old]) < 1e-3
    assert own.out.reason == Reason.OTHER_ARM_LOST
    assert go(-1.0, [old]) > 0.09
    assert go(1.0, [seen]) > 0.09


def test_shafts_may_touch_unless_the_cell_says_otherwise(two: surg_core.Cell) -> None:
    (setup,) = [surg_core.clearance_setup(two, "PSM1")]
    assert setup is not None
    assert setup.shafts == 0.0
    assert [c.name for c in setup.own.capsules if c.shaft] == ["shaft"]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("distance", 0.001, "allowed is 0.005 to 0.2 m"),
        ("distance", 0.5, "allowed is 0.005 to 0.2 m"),
        ("shafts", -0.1, "allowed is 0 to 0.2 m"),
        ("distence", 0.02, "is not a known key"),
        ("obstacles.t.normal", [0.0, 0.0, 2.0], "out of range"),
        ("obstacles.t.radius", 0.1, "clearance.obstacles.t.from"),
    ],
)
def test_a_cell_that_says_it_wrong_is_refused(key: str, value: object, words: str) -> None:
    values: dict[str, object] = {
        "format": "surg_cell/1", "name": "test", "network": "loopback",
        "arms.A.robot": "a", "arms.A.instrument": "b", "arms.A.link": "simulator",
        "arms.A.base.xyz": [0.0] * 3, "arms.A.base.rpy": [0.0] * 3,
        f"clearance.{key}": value,
    }  # fmt: skip
    if key.endswith("normal"):
        values["clearance.obstacles.t.point"] = [0.0] * 3
    with pytest.raises(surg_core.ConfigError, match=words):
        parse_cell(Document("cell.yaml", values))
