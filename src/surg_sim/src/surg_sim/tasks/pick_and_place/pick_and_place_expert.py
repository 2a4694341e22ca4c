"""The script of the peg transfer."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import surg_core
from surg_sim.physics.rigid_grasp import GRIP_DEPTH
from surg_sim.tasks.scripted_arm import ArmExpert

UP = np.array([0.0, 0.0, 1.0])
CLEARANCE = 0.012
"""Distance between the ring and the peg tops while the ring is carried [m]."""
PARTLY_OPEN = 0.34
"""Jaw angle for the approach [rad]: the inner finger fits between ring and peg."""


class PegTransferExpert(ArmExpert):
    """Grasps the ring at its rim, carries it to the other board, lowers and releases it.

    Radius of the ring's centre line and height of the pegs above their board in m.
    """

    def __init__(
        self, cell: surg_core.Cell, seed: int, arm: str, ring_radius: float, peg_height: float
    ) -> None:
        super().__init__(cell, seed, arm)
        self._ring_radius, self._carry_height = ring_radius, peg_height + CLEARANCE

    def script(self) -> Iterator[None]:
        """See ``ArmExpert``."""
        self.jaw = PARTLY_OPEN
        s_W = self.X_WB[:3, :3] @ self.me.s_B
        across = self.X_WR[:3, 1] - (self.X_WR[:3, 1] @ UP) * UP  # where the jaws open to
        rim = self.observation.point("ring") + self._ring_radius * across / np.linalg.norm(across)
        rim = rim + GRIP_DEPTH * s_W + self.rng.normal(scale=2e-4, size=3)
        yield from self.move(rim + 0.025 * UP)
        yield from self.move(rim, 0.8)
        yield from self.squeeze(self.jaw_closed, 0.4)
        yield from self.move(rim + self._carry_height * UP)
        # The ring turns with the shaft: aim with its centre, twice.
        for height in (self._carry_height, self._carry_height, 0.008):
            goal = self.observation.point("goal") + height * UP
            tip = self.observation.point("tip") + goal - self.observation.point("ring")
            yield from self.move(tip, 0.8)
        yield from self.squeeze(0.45, 0.4)
        tip = self.observation.point("tip")
        yield from self.move(tip + 0.03 * UP)
