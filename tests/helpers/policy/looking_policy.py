"""A policy that looks at the endoscope: `python looking_policy.py --server ADDRESS`.

It rests for a second, then goes back and forth; every tenth look it says what it saw.
"""

from __future__ import annotations

import sys

import numpy as np

from surg_policy_client import Chunk, Observation
from surg_policy_client.policies.command_line import run

PICTURE = "observation.images.endoscope.left"
REST = 20
"""Steps."""


class Looking:
    """Half a centimetre to and fro."""

    wants = ("observation.state", PICTURE)

    def __init__(self) -> None:
        self._first: tuple[int, np.ndarray] | None = None

    def act(self, observation: Observation) -> Chunk:
        """The coming steps."""
        picture = observation.arrays[PICTURE]
        if self._first is None:
            self._first = observation.step, observation.held_action()
        first, start = self._first
        n = observation.step - first
        if n % 10 == 0:
            print(f"step {n}: {picture.shape} {picture.dtype} {picture.mean():.1f}", flush=True)
        steps = np.arange(n + 1, n + 9)
        away = 0.0025 * (1.0 - np.cos(2.0 * np.pi * np.maximum(steps - REST, 0) / 40))
        return Chunk(start + away[:, None] * np.eye(len(start))[0])


if __name__ == "__main__":
    sys.exit(run(lambda options: Looking(), __doc__))
