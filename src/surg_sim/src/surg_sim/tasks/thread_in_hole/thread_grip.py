"""Jaws that hold a thread until they open: a weld between the tip and the thread's root."""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.tasks.jaw_weld import JawWeld, rotation, times
from surg_sim.tasks.thread_in_hole.surgical_thread import THREAD

GRIP_DEPTH = 0.002
"""Behind the tip on the shaft axis [m]."""
SHIFT, TURN = 0.0005, np.radians(5.0)
"""Largest error of the drawn grasp: along the shaft [m]; about two axes [rad]."""


class ThreadGrip(JawWeld):
    """The hold of one jawed tool on the thread in a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: str, tip: str) -> None:
        super().__init__(model, data, arm, tip, THREAD)

    def reset(self, rng: np.random.Generator) -> None:
        """Take the thread as drawn; the arms' kinematics are up to date."""
        about_shaft, about_jaw = rng.uniform(-TURN, TURN, 2)
        # Pinched along x of the tip, across the direction in which the jaws open.
        turn = times(
            rotation(np.array([0.0, about_jaw, 0.0])), rotation(np.array([0.0, 0.0, about_shaft]))
        )
        at = np.array([0.0, 0.0, -GRIP_DEPTH + rng.uniform(-SHIFT, SHIFT)])
        self.take(np.zeros(3), at, turn)

    def advance(self) -> None:
        """Let go when the jaws are open; called before the physics of each tick."""
        if self.held and self.open:
            self.let_go()
