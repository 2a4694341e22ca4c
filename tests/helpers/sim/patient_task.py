"""A task that waits for its policy: bring the tip to a drawn place, in a minute."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from surg_sim.tasks.task import State, Task, Verdict

if TYPE_CHECKING:
    from surg_sim.physics.world import World

DEPTH = 0.120
"""[m] Of the tip at home."""


class Patient(Task):
    """The tip shall be 30 mm aside of where it was, at another depth."""

    name = "patient"
    title = "Go there"
    time_limit = 60.0
    home_cell = "sim_ur5e"

    def bind(self, world: World) -> None:
        """Keep the world."""
        self._world = world

    def reset(self, rng: np.random.Generator) -> None:
        """Draw where to go, in the rcm frame."""
        super().reset(rng)
        angle = rng.uniform(-np.pi, np.pi)
        side = 0.03 * np.array([np.cos(angle), np.sin(angle)])
        self._goal = np.array([*side, DEPTH + 0.01])

    def state(self) -> State:
        """The place, and how deep the tip is."""
        truth = self._world.truth("PSM1")
        depth = float((truth.tip - truth.trocar) @ truth.shaft_axis)
        return {"goal": self._goal, "depth": depth}

    def verdict(self) -> Verdict:
        """There within half a millimetre of depth."""
        if abs(float(self.state()["depth"]) - float(np.linalg.norm(self._goal))) < 5e-4:
            return Verdict(done=True, success=True, phase="there")
        return self.late("go") or Verdict(phase="go")
