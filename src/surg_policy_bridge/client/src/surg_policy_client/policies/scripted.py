"""Draws a circle with the tip of every arm, to check the connection."""

from __future__ import annotations

import argparse
import sys

import numpy as np

from surg_policy_client.observation import STATE, Observation
from surg_policy_client.policies.command_line import run

ROWS = 10


class Circle:
    """A circle in x and y of the rcm frame through the present tip, from rest to rest.

    Args:
        radius: [m]
        period: Of one turn [s].
    """

    wants = (STATE,)

    def __init__(self, radius: float = 0.005, period: float = 5.0) -> None:
        if not (0.0 <= radius <= 0.05 and period > 0.0):
            raise ValueError(f"radius is 0 to 0.05 m and period above 0 s: {radius}, {period}")
        self._radius, self._period = radius, period
        self._start: tuple[int, np.ndarray] | None = None

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode; the circle begins at the present tip."""
        self._start = None

    def act(self, observation: Observation) -> np.ndarray:
        """The next rows of the circle."""
        spec = observation.spec
        assert spec.action is not None  # every server has one
        assert spec.period_s is not None
        if self._start is None:
            self._start = observation.step, observation.held_action()
        begun, held = self._start
        steps = observation.step + 1 - begun + np.arange(ROWS)
        # Grows over a second, so that it begins at rest.
        grown = np.clip(steps * spec.period_s, 0.0, 1.0)
        radius = self._radius * grown * grown * (3.0 - 2.0 * grown)
        angle = 2.0 * np.pi * steps * spec.period_s / self._period
        rows = np.tile(held, (ROWS, 1))
        for i, name in enumerate(spec.action.names):
            if name.endswith("x"):
                rows[:, i] += radius * np.cos(angle) - radius
            elif name.endswith("y"):
                rows[:, i] += radius * np.sin(angle)
        return rows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the circle."""
    parser.add_argument("--radius", type=float, default=0.005, metavar="M", help="[m]")
    parser.add_argument("--period", type=float, default=5.0, metavar="S", help="of one turn [s]")


if __name__ == "__main__":
    sys.exit(run(lambda options: Circle(options.radius, options.period), __doc__, add_arguments))
