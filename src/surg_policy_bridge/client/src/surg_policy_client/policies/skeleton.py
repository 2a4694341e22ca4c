"""A policy to begin with: it moves the tip 10 mm up in the world, and stays there.

./surg run bgr --policy skeleton.py
"""

import sys
from typing import Optional

import numpy as np

from surg_policy_client import Observation
from surg_policy_client.policies.command_line import run

STEP = 0.0005  # [m] from one row to the next, 20 times a second: 10 mm/s


class Policy:
    """Goes to a place that it knows in the world."""

    goal: Optional[np.ndarray]
    wants = ("observation.state", "observation.rcm_frame")  # only these are sent

    def reset(self, instruction: str, seed: int) -> None:
        """An episode begins."""
        self.goal = None

    def act(self, observation: Observation) -> np.ndarray:
        """Answer 20 times a second, or as fast as it can."""
        row = observation.held_action()  # where the arm is told to be: x, y, z, roll, jaw
        if self.goal is None:
            self.goal = observation.to_world(row[:3]) + np.array([0.0, 0.0, 0.01])
        way = observation.to_rcm(self.goal) - row[:3]
        row[:3] += way * min(1.0, STEP / max(float(np.linalg.norm(way)), 1e-9))
        return row


if __name__ == "__main__":  # --server ADDRESS, --keys DIR, --episodes N, ...
    sys.exit(run(lambda options: Policy(), __doc__))
