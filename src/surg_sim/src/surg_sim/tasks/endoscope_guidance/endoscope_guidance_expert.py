"""Endoscope guidance: the one who guides, and the script that moves the instrument."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import surg_core
from surg_core.contract import STEP
from surg_sim.tasks.scripted_arm import ArmExpert

AHEAD = 0.30
"""So far ahead the instrument's motion is extrapolated: the arm's stream needs that long [s]."""
SMOOTHING = 0.25
"""Time constant of its estimated velocity [s]."""
REACTION = 0.15
"""Time constant with which the lens closes in on where it should be [s]."""
SPEED_SHARE = 0.7
"""Of the arm's velocity limit that is used."""


class GuidanceExpert(ArmExpert):
    """Turns the endoscope about its trocar so that its axis goes through the instrument's tip."""

    def __init__(self, cell: surg_core.Cell, seed: int, arm: str) -> None:
        super().__init__(cell, seed, arm)
        limits = cell.arms[arm].limits
        self._most = SPEED_SHARE * limits.tip_velocity * STEP
        self._depths = (limits.depth_slow, limits.depth_max)

    def script(self) -> Iterator[None]:
        """See ``ArmExpert``."""
        at = self.path.at
        # The lens stays as far from the tip as it was at the start.
        far = float(np.linalg.norm(self.local(self.observation.point("tip")) - at))
        before, velocity = self.local(self.observation.point("tip")), np.zeros(3)
        while True:
            tip = self.local(self.observation.point("tip"))
            share = STEP / SMOOTHING
            velocity = velocity + share * ((tip - before) / STEP - velocity)
            before = tip
            goal = tip + AHEAD * velocity
            length = float(np.linalg.norm(goal))
            goal = goal * np.clip(length - far, *self._depths) / length
            step = (goal - at) * (STEP / REACTION)
            size = float(np.linalg.norm(step))
            at = at + step * min(1.0, self._most / size if size > 0.0 else 1.0)
            self.path.stay(at)
            yield


class InstrumentScript(ArmExpert):
    """Moves the instrument along the path that the task has drawn."""

    def script(self) -> Iterator[None]:
        """See ``ArmExpert``."""
        start = self.path.at
        while True:
            self.path.stay(start + self.X_WR[:3, :3].T @ self.observation.point("wanted_offset"))
            yield
