"""A policy for the task of `nudge_task.py`: `python nudge_policy.py --server ADDRESS`.

It sends the same actions in every run, so that a run can be repeated without a graph.
"""

from __future__ import annotations

import sys

import numpy as np

from surg_policy_client import Chunk, Observation
from surg_policy_client.policies.command_line import run

ACTION = 5
"""Numbers of an action for each arm."""


def begin(state: np.ndarray) -> np.ndarray:
    """Where the arms are at the first observation, to a tenth of a millimetre, (5 * arms,)."""
    arms = np.asarray(state, dtype=np.float64).reshape(-1, 9)
    return np.round(arms[:, [5, 6, 7, 8, 4]], 4).ravel()


def row(start: np.ndarray, n: int) -> np.ndarray:
    """The n-th action, from 1: a swing that begins and ends at rest, (5 * arms,)."""
    swing = 0.5 * (1.0 - np.cos(2.0 * np.pi * min(n, 20) / 20))
    way = np.array([0.004, -0.003, 0.002, 0.05, 0.0])
    return start + swing * np.tile(way, len(start) // ACTION)


class Nudge:
    """Three steps at a time."""

    wants = ("observation.state",)

    def __init__(self) -> None:
        self._first: tuple[int, np.ndarray] | None = None

    def reset(self, instruction: str, seed: int | None) -> None:
        """Begin at the next observation."""
        del instruction, seed
        self._first = None

    def act(self, observation: Observation) -> Chunk:
        """The coming steps."""
        if self._first is None:
            start = begin(observation.arrays["observation.state"])
            self._first = observation.step, start
        first, start = self._first
        n = observation.step - first
        return Chunk(np.array([row(start, n + i) for i in (1, 2, 3)]))


if __name__ == "__main__":
    sys.exit(run(lambda options: Nudge(), __doc__))
