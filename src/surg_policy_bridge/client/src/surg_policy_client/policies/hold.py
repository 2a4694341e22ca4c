"""Holds still: every action is the present set-point."""

from __future__ import annotations

import sys

import numpy as np

from surg_policy_client.observation import STATE, Observation
from surg_policy_client.policies.command_line import run


class Hold:
    """Keeps set-point, roll and jaw of the episode's first observation."""

    wants = (STATE,)

    def __init__(self) -> None:
        self._held: np.ndarray | None = None

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode; hold its first set-point."""
        self._held = None

    def act(self, observation: Observation) -> np.ndarray:
        """The held action for the next eight grid times."""
        if self._held is None:
            self._held = observation.held_action()
        return np.tile(self._held, (8, 1))


if __name__ == "__main__":
    sys.exit(run(lambda options: Hold(), __doc__))
