"""How far tip and shaft can still go until rest, against arms that are stopped in every way.

The oracle is `stop_adversary`: a plant with the makers' kinematics, whose delays, lags and brakes
are drawn anew for every stop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import surg_core
from helpers.control.joint_plant import ROBOTS, JointPlant, T, pose, sideways
from helpers.control.stop_adversary import Ranges, Stopping, off_pivot, tip_and_shaft, worst

LAGS = {"sim_ur5e": np.linspace(0.004, 0.008, 6), "sim_panda": np.linspace(0.004, 0.008, 7)}
KEPT = 80
"""Commands that are remembered."""
SMALL = 5e-4
"""Of the worst that was seen, below it no ratio is judged [m]: the commands' own changes count."""

NEAR = 1.5
"""Times the worst that was seen: the bound is not above it but in a few slow states."""


def bound_of(arm: JointPlant) -> tuple[float, float]:
    return arm.out.stop_bound_tip, arm.out.stop_bound_pivot


def near_singular(arm: JointPlant) -> None:
    """A UR5e with its wrist nearly stretched, its trocar moved along."""
    arm.q[4] = -0.06
    X_BF = np.asarray(arm.arm.chain.forward(arm.q))
    tip = X_BF[:3, :3] @ np.asarray(arm.arm.tool.p_FTip) + X_BF[:3, 3]
    arm.controller.set_rcm(tip - 0.12 * X_BF[:3, :3] @ np.asarray(arm.arm.tool.s_F))


def tracked(arm: JointPlant) -> None:
    a = arm.arm
    arm.controller = surg_core.Controller(
        a.chain, a.robot, a.limits, a.instrument, a.tool, track_rcm=True
    )
    arm.controller.set_rcm(np.asarray(a.trocar.p_BRcm))


def breathing(arm: JointPlant, t: float) -> surg_core.Readings:
    """A trocar that moves by 5 mm at 0.25 Hz from time 0 on."""
    w = 2 * np.pi * 0.25
    up = np.array([0.0, 0.0, 0.005])
    p = np.asarray(arm.arm.trocar.p_BRcm) + (1 - np.cos(w * t)) * up
    return surg_core.Readings(p_BTrack=p, v_BTrack=w * np.sin(w * t) * up)


Family = tuple[str, Callable[[JointPlant], None] | None]
FAMILIES: dict[str, Family] = {
    **{cell: (cell, None) for cell in ROBOTS},
    "near singular": ("sim_ur5e", near_singular),
    **{f"{cell}, moving trocar": (cell, tracked) for cell in ROBOTS},
}


def states(family: str, seed: int, count: int) -> tuple[surg_core.Arm, list[Stopping]]:
    """States of an arm whose tip follows a drawn figure, from slow to as fast as it may be."""
    cell, prepare = FAMILIES[family]
    rng = np.random.default_rng(seed)
    arm = JointPlant(cell, LAGS[cell])
    if prepare:
        prepare(arm)
    assert arm.start() == surg_core.Reason.NONE
    sent = [np.zeros(len(arm.q))] * KEPT
    found: list[Stopping] = []
    phase, speed = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.3, 1.0, 3) * 2 * np.pi
    size = rng.uniform(0.2, 1.0) * np.array([0.04, 0.035, 0.02])
    for k in range(60 * count):
        ramp = min(k * T, 1.0)
        p = [0.0, 0.0, 0.12] + ramp * size * np.sin(speed * k * T + phase)
        q, qd = arm.measured(), arm.qd.copy()
        seen = {"readings": breathing(arm, k * T)} if prepare is tracked else {}
        out = arm.step(pose(p), **seen)
        sent = [np.array(out.qd_command), *sent[: KEPT - 1]]
        if k % 60 == 59:
            place = np.asarray(out.p_BRcm)
            found.append(Stopping(q, qd, np.array(sent), place, bound_of(arm)))
    assert arm.out.state == surg_core.State.ENABLED
    return arm.arm, found


@pytest.mark.parametrize("family", FAMILIES)
def test_no_stop_goes_farther_and_the_worst_nearly_as_far(family: str, full: bool) -> None:
    figures, count, each = (25, 20, 1000) if full else (3, 12, 250)
    ratios, runs = [], 0
    for seed in range(figures):
        arm, found = states(family, seed, count)
        rng = np.random.default_rng(100 + seed)
        for state in found:
            seen = np.array(worst(arm, state, Ranges.of(arm.robot), each, rng))
            runs += each
            assert (seen <= np.array(state.bound) + 1e-6).all(), (family, seed, seen, state)
            ratios.append(np.where(seen > SMALL, np.array(state.bound) / seen, np.nan))
    tip, pivot = np.array(ratios).T
    for name, of in (("tip", tip[~np.isnan(tip)]), ("pivot", pivot[~np.isnan(pivot)])):
        print(
            f"{family}: {runs} stops, 0 farther; bound over the worst of {each}, {name}: "
            f"median {np.median(of):.2f}, {np.mean(of <= NEAR):.1%} below {NEAR}, "
            f"max {np.max(of):.2f}"
        )
        median, most = (1.2, 0.98) if family in ROBOTS else (NEAR, 0.5)
        assert np.median(of) < median and np.quantile(of, most) <= NEAR and np.max(of) < 2.0


@pytest.mark.parametrize("cell", ROBOTS)
def test_an_arm_that_brakes_worse_than_stated_goes_farther(cell: str) -> None:
    arm, found = states(cell, 1, 12)
    ranges = Ranges.of(arm.robot)
    weak = replace(ranges, least=0.4 * ranges.least, lead=0.4 * ranges.lead)
    rng = np.random.default_rng(1)
    farther = [np.array(worst(arm, s, weak, 200, rng)) > np.array(s.bound) for s in found]
    assert np.array(farther).all(axis=1).any()


@pytest.mark.parametrize("cell", ROBOTS)
@pytest.mark.parametrize("way", ["silent", "brakes"])
def test_it_holds_in_every_cycle_while_the_arm_stops(cell: str, way: str, full: bool) -> None:
    """The controller lives on, and does not know of it at first."""
    rng = np.random.default_rng(2)
    checked = 0
    for _ in range(40 if full else 4):
        delay = rng.uniform(0.0, 0.004)
        arm = JointPlant(cell, rng.uniform(0.002, 0.008, len(LAGS[cell])), delay)
        arm.start()
        arm.sweep(rng.uniform(0.04, 0.15), rng.uniform(0.5, 2.0))
        ranges, begun = Ranges.of(arm.arm.robot), arm.time
        arm.silent = way == "silent"
        bounds, path = [], []
        for k in range(250):
            if way == "brakes" and k == 3:
                arm.brakes = rng.uniform(ranges.least, ranges.most)
            path.append(arm.q)
            arm.step(sideways(0.1, arm.time - begun))
            bounds.append(bound_of(arm))
        assert np.abs(arm.qd).max() == 0.0
        tip, s = tip_and_shaft(arm.arm, np.array(path))
        off = off_pivot(tip, s, np.asarray(arm.out.p_BRcm))
        known = [k for k in range(100) if np.isfinite(bounds[k][0])]
        for k in known if way == "silent" else known[2:]:
            assert np.linalg.norm(tip[k:] - tip[k], axis=1).max() <= bounds[k][0] + 2e-5, k
            assert off[k:].max() <= bounds[k][1] + 2e-5, k
            checked += 1
    print(f"{cell}, {way}: {checked} cycles, 0 farther")
    assert checked > 100


@pytest.mark.parametrize("cell", ROBOTS)
def test_an_arm_at_rest_goes_nowhere(cell: str) -> None:
    arm = JointPlant(cell)
    arm.start()
    for _ in range(100):
        arm.step()
    tip, pivot = bound_of(arm)
    assert tip < 1e-6 and pivot == pytest.approx(arm.out.rcm_error, abs=1e-6)


def test_without_a_state_nothing_is_known() -> None:
    arm = JointPlant()
    arm.start()
    arm.step(state_valid=False)
    assert np.isnan(bound_of(arm)).all()
