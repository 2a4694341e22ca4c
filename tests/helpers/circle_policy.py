"""A policy that leads the tip along a circle: `python circle_policy.py --server ADDRESS`.

It begins at the set-point that it finds and comes up to its speed within half a second.
"""

from __future__ import annotations

import argparse

import numpy as np

from surg_policy_client import Chunk, Observation, serve

RADIUS = 0.015
"""[m]"""
RAMP = 0.5
"""[s] Until the speed is reached."""


class Circle:
    """The tip on a circle in the plane across the home shaft axis.

    Args:
        speed: Of the tip [m/s].
        rows: Steps per answer.
    """

    wants = ("observation.state",)

    def __init__(self, speed: float, rows: int) -> None:
        self._speed, self._rows = speed, rows
        self._begin: tuple[int, np.ndarray, int] | None = None

    def reset(self, instruction: str, seed: int | None) -> None:
        """Begin anew where the arm is."""
        del instruction, seed
        self._begin = None

    def act(self, observation: Observation) -> Chunk:
        """The coming steps."""
        state = dict(
            zip(
                observation.spec.observation["observation.state"].names,
                observation.arrays["observation.state"].astype(float),
                strict=True,
            )
        )
        gap = self._begin is not None and observation.step - self._begin[2] > 4
        if self._begin is None or gap:
            now = [state[f"PSM1/set_{axis}"] for axis in "xyz"]
            roll, jaw = state["PSM1/roll_set"], state["PSM1/jaw"]
            self._begin = (observation.step, np.array([*now, roll, jaw]), observation.step)
        first, start, _ = self._begin
        self._begin = (first, start, observation.step)
        rows = []
        for step in range(observation.step + 1, observation.step + 1 + self._rows):
            t = 0.05 * (step - first)
            way = self._speed * (t - RAMP / 2 if t > RAMP else t * t / (2 * RAMP))
            angle = way / RADIUS
            moved = [RADIUS * (1 - np.cos(angle)), RADIUS * np.sin(angle), 0.0, 0.0, 0.0]
            rows.append(start + moved)
        return Chunk(np.array(rows), observation.step + 1)


def main() -> None:
    """Serve."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--server", required=True)
    parser.add_argument("--speed", type=float, default=0.05)
    parser.add_argument("--rows", type=int, default=10)
    options = parser.parse_args()
    serve(Circle(options.speed, options.rows), options.server)


if __name__ == "__main__":
    main()
