"""A policy that sees points with both eyes and moves to them through the cell's calibration.

In place of a network, the points are the simulator's, with the noise of a network that fuses looks:
what is tested is the frame. The policies of `./surg learn` read no calibration.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.perception.drift_bench import Moved
from helpers.perception.drift_recovery import Recovery, drawn
from helpers.results.perception_results import PAGE
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import run_episode
from surg_sim.physics import cell_files
from surg_sim.tasks.bgr.bgr_expert import RobotExpert
from surg_sim.tasks.scripted_sender import Action, Observation

NOISE, LOOKS = 1.0, 20
"""[px] Of a point in one picture; pictures that are fused."""
FOCAL, BASELINE = 600.0, 0.0045
"""[px], [m] Of the eyes."""


class Seeing(RobotExpert):
    """Takes the bowel's nodes from the picture."""

    def see(self, session: CellSession, E: np.ndarray) -> Seeing:
        """Through eyes that stand otherwise than the cell states: E (4, 4) of `Recovery.frame`."""
        self._view, self._E = session.task.view, E  # type: ignore[attr-defined]
        return self

    def act(self, observation: Observation) -> Action:
        X_WV = self._view.pose
        nodes = (observation.point("nodes") - X_WV[:3, 3]) @ X_WV[:3, :3]
        off = self.rng.normal(scale=NOISE / np.sqrt(LOOKS), size=3)
        z = FOCAL * BASELINE / (FOCAL * BASELINE / nodes[:, 2] + off[2] * np.sqrt(2.0))
        across = nodes[:, :2] / nodes[:, 2:] + off[:2] / FOCAL
        seen = np.column_stack([across * z[:, None], z])
        stated = seen @ self._E[:3, :3].T + self._E[:3, 3]
        task = dict(observation.task) | {"nodes": stated @ X_WV[:3, :3].T + X_WV[:3, 3]}
        return super().act(replace(observation, task=task))


@pytest.mark.full
def test_a_policy_that_uses_the_calibration_is_cured(tmp_path: Path) -> None:
    count, solved = 20, dict.fromkeys(("unmoved", "moved", "accepted"), 0)
    session = CellSession(cell_files.find("sim_two_arms"), "bgr")
    for seed in range(count):
        rng = np.random.default_rng(seed)
        moved = Moved(camera=np.r_[drawn(rng, *[np.radians(5.0)] * 2), drawn(rng, 0.01, 0.01)])
        made = Recovery(tmp_path / str(seed), seed, moved)
        frames = {"unmoved": made.frame(Moved()), "moved": made.frame(moved)}
        made.accept_at_last()
        frames["accepted"] = made.frame(moved)
        for name, E in frames.items():
            episode = 20_040 + seed
            experts = session.task.experts(session.cell, episode)
            policy = Seeing(session.cell, episode).see(session, E)
            report = run_episode(session, episode, {**experts, "expert": policy})
            print(seed, name, report.success, report.reason)
            solved[name] += report.success
    said = ", ".join(f"{name} {n}" for name, n in solved.items())
    PAGE.note("drift: policy by calibration, camera 10 mm, 5°", count, said)
    print(said)
    assert solved["accepted"] >= solved["unmoved"] - 0.1 * count
    assert solved["moved"] <= 0.8 * solved["unmoved"]
