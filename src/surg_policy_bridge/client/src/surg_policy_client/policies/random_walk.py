"""Random walk: small normal steps of tip and roll; the jaw stays."""

from __future__ import annotations

import argparse
import sys

import numpy as np

from surg_policy_client.observation import STATE, Observation
from surg_policy_client.policies.command_line import run


class RandomWalk:
    """Random walk; the same seed gives the same walk.

    Args:
        step: Standard deviation of a step of x, y, z [m] per grid time.
        turn: Standard deviation of the roll [rad] per grid time.
    """

    wants = (STATE,)

    def __init__(self, step: float = 0.0005, turn: float = 0.01) -> None:
        self._sigma = {"x": step, "y": step, "z": step, "roll": turn}
        self._draw = np.random.default_rng(0)
        self._at: np.ndarray | None = None

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode; the walk begins at the present pose."""
        self._draw = np.random.default_rng(seed)
        self._at = None

    def act(self, observation: Observation) -> np.ndarray:
        """One row: the next step of the walk, within the server's limits."""
        action = observation.spec.action
        assert action is not None  # every server has one
        at = observation.held_action() if self._at is None else self._at
        sigma = [self._sigma.get(name.rpartition("/")[2], 0.0) for name in action.names]
        at = at + self._draw.normal(size=len(sigma)) * sigma
        if action.low is not None and action.high is not None:
            at = np.clip(at, action.low, action.high)
        self._at = at
        return at[np.newaxis]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the walk."""
    parser.add_argument("--step", type=float, default=0.0005, metavar="M", help="of a step [m]")


if __name__ == "__main__":
    sys.exit(run(lambda options: RandomWalk(options.step), __doc__, add_arguments))
