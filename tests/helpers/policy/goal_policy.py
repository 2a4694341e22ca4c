"""A policy for `patient_task.py`: `python goal_policy.py --server ADDRESS`. 20 mm/s, straight."""

from __future__ import annotations

import sys

import numpy as np

from surg_policy_client import Chunk, Observation
from surg_policy_client.policies.command_line import run

STEP = 0.001
"""[m] In a period."""


class Goal:
    """Goes on from wherever the arm is: it remembers nothing."""

    wants = ("observation.state", "privileged.task_state")

    def act(self, observation: Observation) -> Chunk:
        """The coming steps."""
        state = observation.arrays["observation.state"].astype(float)
        goal = observation.arrays["privileged.task_state"].astype(float)[:3]
        now, roll, jaw = state[5:8], state[8], state[4]
        way = goal - now
        far = float(np.linalg.norm(way))
        rows = []
        for n in range(1, 9):
            share = min(1.0, n * STEP / max(far, 1e-9))
            rows.append([*(now + share * way), roll, jaw])
        return Chunk(np.array(rows))


if __name__ == "__main__":
    sys.exit(run(lambda options: Goal(), __doc__))
