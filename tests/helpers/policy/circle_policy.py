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
ASTRAY = 0.008
"""[m] An arm that rests further from where it should be was stopped, or led by somebody else:
begin anew. One that moves is catching up, and a step back would be refused.
"""
AT_REST = 1e-4
"""[m] An arm moves less in a step."""


class Circle:
    """The tip on a circle in the plane across the home shaft axis.

    Args:
        speed: Of the tip [m/s].
        rows: Steps per answer.
    """

    wants = ("observation.state",)

    def __init__(self, speed: float, rows: int) -> None:
        self._speed, self._rows = speed, rows
        self._begin: tuple[int, np.ndarray] | None = None
        self._last: np.ndarray | None = None
        self._home: np.ndarray | None = None
        self._bearing = 0.0  # of the circle's middle, from where it begins [rad]

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
        now = np.array([state[f"PSM1/set_{axis}"] for axis in "xyz"])
        if self._begin is not None:
            first, start = self._begin
            astray = float(
                np.linalg.norm(self._row(observation.step - first)[:3] + start[:3] - now)
            )
        rests = self._last is not None and float(np.linalg.norm(now - self._last)) < AT_REST
        self._last = now
        if self._begin is None or (astray > ASTRAY and rests):
            self._turn_home(now)
            self._begin = (
                observation.step,
                np.array([*now, state["PSM1/roll_set"], state["PSM1/jaw"]]),
            )
        first, start = self._begin
        steps = range(observation.step + 1, observation.step + 1 + self._rows)
        rows = [start + self._row(step - first) for step in steps]
        return Chunk(np.array(rows), observation.step + 1)

    def _turn_home(self, now: np.ndarray) -> None:
        """However often it begins anew, the circles stay about where the first one was."""
        if self._home is None:
            self._home = now
        x, y, _ = self._home - now
        if np.hypot(x, y) > RADIUS:
            self._bearing = float(np.arctan2(y, x))

    def _row(self, n: int) -> np.ndarray:
        """How far from the beginning after n steps, (5,)."""
        t = 0.05 * n
        angle = self._speed * (t - RAMP / 2 if t > RAMP else t * t / (2 * RAMP)) / RADIUS
        x, y = RADIUS * (1 - np.cos(angle)), RADIUS * np.sin(angle)
        c, s = np.cos(self._bearing), np.sin(self._bearing)
        return np.array([c * x - s * y, s * x + c * y, 0.0, 0.0, 0.0])


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
