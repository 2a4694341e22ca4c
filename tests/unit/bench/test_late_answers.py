"""A policy whose answers come late solves its task: the task itself is the judge."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import numpy as np

from surg_cli.host import paths

sys.path.insert(0, str(paths.ROOT / "benchmarks"))

from policy import card_cell
from policy.card_cell import CellJob

from surg_core.contract import STEP
from surg_policy_client import Observation, serve

AHEAD, SMOOTHING, REACTION = 0.30, 0.25, 0.15
"""Of the task's own expert [s]."""
NOISE = 1e-3
"""Standard deviation of what it sees of the tip: its answers disagree, as a network's do [m]."""


class Guide:
    """Keeps an endoscope on a moving tip, in chunks of what the task's expert would do next."""

    wants = ("observation.state", "observation.rcm_frame", "privileged.task_state")

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode."""
        self._rng = np.random.default_rng(1)
        self._before: np.ndarray | None = None
        self._velocity = np.zeros(3)

    def act(self, observation: Observation) -> np.ndarray:
        """The next 0.8 s, from the command in force on."""
        p_W = [observation.named(f"tip_{i}", "privileged.task_state") for i in range(3)]
        tip = observation.to_rcm(p_W) + NOISE * self._rng.standard_normal(3)
        row = observation.held_action()
        at = row[:3]
        if self._before is None:
            self._before, self._far = tip, float(np.linalg.norm(tip - at))
        seen = (tip - self._before) / STEP
        self._velocity = self._velocity + STEP / SMOOTHING * (seen - self._velocity)
        self._before = tip
        rows = []
        for k in range(16):
            goal = tip + (AHEAD + k * STEP) * self._velocity
            goal *= 1.0 - self._far / np.linalg.norm(goal)
            at = at + (goal - at) * (STEP / REACTION)
            rows.append([*at, *row[3:]])
        return np.array(rows)


def test_answers_250_ms_late_solve_the_task(tmp_path: Path) -> None:
    """Where each answer replaced the plan at once, the arm was paused within a second."""
    address = f"ipc://{tmp_path / 'policy'}"
    said: list[str] = []
    client = threading.Thread(
        target=serve,
        args=(Guide(), address),
        kwargs={"episodes": 1, "timeout_s": 60.0, "say": said.append},
    )
    client.start()
    job = CellJob(address, "endoscope_guidance", "answers 250 ms late", (20000,))
    (episode,) = card_cell.play(job)["episodes"]
    client.join()
    assert episode["success"], (episode, said)
    assert episode["late"] > 2000 and episode["rejected"] == {}
