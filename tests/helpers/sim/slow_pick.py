"""Pick and place with a sender that thinks once for longer than the bridge waits in silence."""

from __future__ import annotations

import time
from collections.abc import Mapping

import surg_core
from surg_core.contract import GRID
from surg_sim.tasks.pick_and_place import pick_and_place_task
from surg_sim.tasks.scripted_sender import Action, Expert, Observation

THINKS = 3.0
"""Above a fifth of the run's abort_timeout, after which a state is published again [s]."""


class SlowPick(pick_and_place_task.PickAndPlace):
    """As pick_and_place, for half a second."""

    name = "slow_pick"
    title = "The first half second of pick and place, slowly"
    time_limit = 0.5

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """The task's own, slower."""
        return {name: Slow(each) for name, each in super().experts(cell, seed).items()}


class Slow(Expert):
    """Thinks at the first look after the start."""

    def __init__(self, expert: Expert) -> None:
        self._expert, self.arms = expert, expert.arms

    def act(self, observation: Observation) -> Action:
        """As the expert, later."""
        if observation.tick == GRID:
            time.sleep(THINKS)
        return self._expert.act(observation)
