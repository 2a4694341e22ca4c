"""What the force-aware policies of bgr are compared by: inputs, seeds, and what is done to them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from surg_core.contract import FORCE_KEY

LIMIT = 2.0
"""Largest force on the jaws in the retraction that counts as a success [N]."""
RETRACTION = ("retract", "still", "done")
"""Phases in which the force counts."""


@dataclass(frozen=True)
class Case:
    """One training, and what its force is replaced by in the roll-outs."""

    forces: bool  # observation.force is read
    tension: bool  # the simulator's tension is read
    seed: int  # of the training
    felt: str = "true"  # or "zero", "other": the readings of another episode

    @property
    def weights(self) -> str:
        """Name of the file of its weights."""
        return f"weights_{'force' if self.forces else 'blind'}_{int(self.tension)}_{self.seed}.npz"

    @property
    def name(self) -> str:
        """Of its roll-outs."""
        return f"{self.weights.removeprefix('weights_').removesuffix('.npz')}_{self.felt}"


def cases(seeds: Sequence[int]) -> list[Case]:
    """All, those that answer the question first."""
    found = [Case(forces, False, seed) for seed in seeds for forces in (False, True)]
    found += [Case(True, False, seed, felt) for seed in seeds for felt in ("zero", "other")]
    return found + [Case(forces, True, seed) for seed in seeds for forces in (False, True)]


@dataclass(frozen=True)
class Result:
    """One roll-out."""

    case: str
    seed: int
    success: bool  # of the task
    reason: str
    peak: float  # largest force on the robot's jaws in the retraction [N]
    tension: float  # largest tension of the tissue in the retraction [N]
    time: float  # from the retraction's begin to the end [s]

    @property
    def good(self) -> bool:
        """Solved, and within the limit."""
        return self.success and self.peak <= LIMIT


class Felt:
    """A policy whose force is replaced: by nothing, or by that of another episode."""

    def __init__(self, policy: Any, other: np.ndarray | None) -> None:
        self._policy, self._other, self._step = policy, other, 0

    def reset(self, instruction: str, seed: int | None) -> None:
        """Forget the last episode."""
        self._policy.reset(instruction, seed)
        self._step = 0

    def act(self, observation: Any) -> Any:
        """The policy's answer to what it is made to feel."""
        arrays = dict(observation)
        if self._other is None:
            felt = np.zeros_like(arrays[FORCE_KEY])
            felt[..., 3::4] = arrays[FORCE_KEY][..., 3::4]  # still said to be known
        else:
            felt = self._other[min(self._step, len(self._other) - 1)]
        self._step += 1
        return self._policy.act({**arrays, FORCE_KEY: felt})


class Meter:
    """Largest force on the jaws and tension in the retraction of a session's newest episode."""

    def __init__(self, session: Any, arm: str) -> None:
        self._session, self._arm, self._inner = session, arm, session.tick
        session.tick = self._tick
        self.clear()

    def clear(self) -> None:
        """Before an episode."""
        self.peak = self.tension = 0.0
        self.ticks = 0

    def _tick(self, *given: Any) -> Any:
        found, task = self._inner(*given), self._session.task
        if task.phase in RETRACTION:
            self.ticks += 1
            self.peak = max(self.peak, float(np.linalg.norm(task.jaw_force(self._arm))))
            self.tension = max(self.tension, float(task.tension))
        return found


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))
