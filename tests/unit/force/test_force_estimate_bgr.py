"""The estimate beside the simulator's truth while bowel is grasped and retracted."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.force.loaded_arm import (
    SENSOR,
    STALE,
    TICK,
    RandomLoad,
    calibrated,
    inside,
    pull_at_tip,
    rms,
    sensing_cell,
)
from helpers.force.statics import Array
from surg_cli.host import paths
from surg_core.force.compensation import gravity_in_base
from surg_core.force.estimator import ForceEstimate, ForceEstimator
from surg_core.force.load_solver import LoadFit
from surg_core.force.sensor_file import load_sensor
from surg_sim.envs.cell_session import CellSession, Tick
from surg_sim.envs.episode_runner import run_episode

ARM = "PSM1"
SHORT = str(paths.ROOT / "tests" / "helpers" / "sim" / "short_bgr.py")
SEEDS = range(20_000, 20_006)
"""Six episodes last longer than 60 s."""


class Watcher:
    """Pulls at the tip, estimates every 10 ms, and notes the truth beside it; base axes [N]."""

    def __init__(self, session: CellSession, fit: LoadFit, most: float) -> None:
        self.session, self.most = session, most
        arm = self.arm = session.cell.arms[ARM]
        self._estimator = ForceEstimator(
            fit.load, load_sensor(SENSOR), arm.tool.s_F, arm.tool.p_FTip,
            gravity_in_base(arm.X_WB[:3, :3]),
        )  # fmt: skip
        self._tip_id = session.world.model.body(f"{ARM}_{arm.instrument.tip_link}").id
        self.rows: list[tuple[float, ForceEstimate, Array, Array]] = []
        self.count = 0

    def begin(self, seed: int) -> None:
        """A new episode: the sensor's window is empty and nothing pulls yet."""
        self._estimator = dataclasses.replace(self._estimator)
        self._load = RandomLoad(np.random.default_rng(seed), self.most)
        self._pull = np.zeros(3)

    def see(self, tick: Tick) -> None:
        """After every tick."""
        world, arm, t = self.session.world, self.arm, tick.tick * TICK
        state = world.state(ARM)
        X_BF = arm.chain.forward(state.q)
        twist = arm.chain.jacobian(state.q) @ state.qd
        _, p_BRcm, _ = world.trocar(ARM).point.observed(STALE)
        self._estimator.add(t, world.force_sensors[ARM].reading, X_BF, twist, p_BRcm)
        s = X_BF[:3, :3] @ arm.tool.s_F
        across = np.eye(3) - np.outer(s, s)
        grasped = world.tip_force(ARM)
        assert grasped is not None
        if tick.tick % 5 == 0:
            self.count += 1
            estimate = self._estimator.estimate()
            if estimate.valid and estimate.forces is not None:
                row = (across @ (grasped + self._pull), -across @ world.trocar(ARM).force)
                self.rows.append((float(tick.outputs[ARM].depth), estimate, *row))
        self._pull = self._load.at(t)
        pull_at_tip(world, self._tip_id, arm.X_WB_stated[:3, :3] @ self._pull)


@pytest.fixture(scope="module")
def cell() -> surg_core.Cell:
    return sensing_cell("sim_two_arms")


@pytest.fixture(scope="module")
def fit(cell: surg_core.Cell, tmp_path_factory: pytest.TempPathFactory) -> LoadFit:
    folder: Path = tmp_path_factory.mktemp("bench")
    return calibrated(cell, folder)


@pytest.mark.parametrize("most", [0.0, 5.0])
def test_the_tips_force_while_bowel_is_retracted(
    cell: surg_core.Cell, fit: LoadFit, full: bool, most: float
) -> None:
    """Breathing, a seal that rubs, a tool calibrated wrongly; with and without a random pull."""
    session = CellSession(cell, "bgr" if full else SHORT, "in_vivo", SEEDS[0])
    watcher, done = Watcher(session, fit, most), 0
    for seed in SEEDS if full else SEEDS[:1]:
        watcher.begin(seed)
        done += run_episode(session, seed, watch=watcher.see).success
    rows = [row for row in watcher.rows if row[0] >= 0.06]
    tip = [e.forces.tip - truth for _, e, truth, _ in rows if e.forces]
    trocar = [e.forces.trocar - truth for _, e, _, truth in rows if e.forces]
    said = [e for _, e, *_ in rows]
    held, kept = inside(said, tip, slice(0, 3)), inside(said, trocar, slice(3, 6))
    print(
        f"pull of up to {most:g} N: {done} successes, {len(rows)} estimates of {watcher.count} at "
        f"{1e3 * min(r[0] for r in rows):.0f} to {1e3 * max(r[0] for r in rows):.0f} mm: tip "
        f"{rms(tip):.3f} N rms of {rms([r[2] for r in rows]):.2f} (largest "
        f"{max(np.linalg.norm(r[2]) for r in rows):.1f}), trocar {rms(trocar):.3f}; inside 95 %: "
        f"tip {held:.3f}, trocar {kept:.3f}"
    )
    assert len(rows) >= watcher.count - 10  # the window fills at the start of an episode
    assert rms(tip) <= 0.15
    if full:
        assert done == len(SEEDS) and len(rows) * 5 * TICK > 60.0
        assert 0.90 <= held <= 0.99 and 0.90 <= kept <= 0.99
