"""The script of the peg transfer."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from surg_sim.physics.rigid_grasp import GRIP_DEPTH
from surg_sim.tasks.pick_and_place.pick_and_place_task import ARM, PEG_HEIGHT, RING_RADIUS
from surg_sim.tasks.scripted_arm import ArmExpert

if TYPE_CHECKING:
    import surg_core

Array = NDArray[np.float64]

UP = np.array([0.0, 0.0, 1.0])
CLEAR = PEG_HEIGHT + 0.012
"""Height above a board at which the ring passes over the pegs [m]."""
PARTLY_OPEN = 0.34
"""Jaw angle for the approach [rad]: the inner finger fits between ring and peg."""


class PegTransferExpert(ArmExpert):
    """Takes the ring at its rim, carries it over, lowers it and lets go."""

    def __init__(self, cell: surg_core.Cell, seed: int) -> None:
        super().__init__(cell, seed, ARM)

    def script(self) -> Iterator[None]:
        """See ``ArmExpert``."""
        self.jaw = PARTLY_OPEN
        s_W = self.X_WB[:3, :3] @ self.me.s
        across = self.X_WR[:3, 1] - (self.X_WR[:3, 1] @ UP) * UP  # where the jaws open to
        rim = self.view.point("ring") + RING_RADIUS * across / np.linalg.norm(across)
        rim = rim + GRIP_DEPTH * s_W + self.rng.normal(scale=2e-4, size=3)
        yield from self.move(rim + 0.025 * UP)
        yield from self.move(rim, 0.8)
        yield from self.squeeze(self.jaw_closed, 0.4)
        yield from self.move(rim + CLEAR * UP)
        # The ring turns with the shaft: aim with its centre, twice.
        for height in (CLEAR, CLEAR, 0.008):
            goal = self.view.point("goal") + height * UP
            tip = self.view.point("tip") + goal - self.view.point("ring")
            yield from self.move(tip, 0.8)
        yield from self.squeeze(0.45, 0.4)
        tip = self.view.point("tip")
        yield from self.move(tip + 0.03 * UP)
