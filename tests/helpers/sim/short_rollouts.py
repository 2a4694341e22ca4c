"""Roll-outs of a policy without pictures that take seconds, for pools and clusters."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surg_sim.envs.policy_rollouts import roll_out
from surg_sim.envs.surg_env import SurgEnv

LIMIT = 4.0
"""[s] simulated that an episode takes: the policy does not solve it."""


Job = tuple[int, Path]
"""Seed, and the folder of who has begun."""


@dataclass(frozen=True)
class Result:
    """Of a roll-out."""

    seed: int
    success: bool
    hash: str


class Circling:
    """Moves its tip round a circle, drawn from the episode's seed."""

    def reset(self, instruction: str, seed: int | None) -> None:
        """Draw the circle."""
        self._phase = float(np.random.default_rng(seed).uniform(0.0, 2 * np.pi))

    def act(self, observation: Any) -> Any:
        """A step of 1 mm from the last command."""
        state = observation["observation.state"].astype(float)
        self._phase += 0.1
        step = 1e-3 * np.array([np.cos(self._phase), np.sin(self._phase), 0.0])
        return np.array([[*(state[5:8] + step), state[8], state[4]]])


def play(job: Job) -> Result:
    """A roll-out that notes in the folder that it began, and where."""
    seed, folder = job
    begun = len(list(folder.glob(f"{seed}.*")))
    Path(folder, f"{seed}.{begun}").write_text(f"{os.getpid()}\n")
    env = SurgEnv("pick_and_place")
    env.session.task.time_limit = LIMIT  # type: ignore[misc]
    done = roll_out(env, Circling(), seed)
    env.close()
    return Result(seed, done.success, done.hash)
