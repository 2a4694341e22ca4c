#!/usr/bin/env python3
"""Step 9: a policy of your own drives the arm through the model server.

You learn: the client library (``pip install ./src/surg_policy_bridge/client``: no ROS, nothing else
of the platform). The policy connects to the model server; the server's safety controller judges
every action. docs/guide/policy_client.md explains observation, action and errors.

    ./surg run examples/04_task.py --policy examples/09_policy.py --observe privileged --seed 20000
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

from surg_policy_client import Observation
from surg_policy_client.policies.command_line import run

WEIGHTS = "SURG_COURSE_WEIGHTS"
"""Environment variable with the path of the weights."""
ROWS = 8
"""Actions per answer; the server plays the next ones when an answer is late."""


class TouchPolicy:
    """Moves the tip to the ball with the matrix of step 8."""

    wants = ("observation.state", "privileged.task_state")

    def __init__(self, weights: Path) -> None:
        self._W = np.load(weights)["W"]

    def reset(self, instruction: str, seed: int | None) -> None:
        """An episode begins; this policy remembers nothing."""

    def act(self, observation: Observation) -> np.ndarray:
        """Answer one observation with the next actions, (ROWS, 5): x, y, z, roll, jaw."""
        ball = [observation.named(f"ball_{i}", "privileged.task_state") for i in range(3)]
        rows = np.tile(observation.held_action(), (ROWS, 1))
        p = rows[0, :3]
        for row in rows:
            p = p + np.array([*p, *ball, 1.0]) @ self._W
            row[:3] = p
        return rows


if __name__ == "__main__":
    file = Path(os.environ.get(WEIGHTS, "runs/course/weights.npz"))
    if not file.is_file():
        sys.exit(f"{file}: no such file; run examples/08_training.py first")
    sys.exit(run(lambda options: TouchPolicy(file), __doc__))
