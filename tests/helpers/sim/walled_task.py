"""A wall beside the tip, for tests of haptics: a spring pushes the jaws back."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from patient_task import Patient

STIFFNESS = 400.0
"""[N/m]"""
ROOM = 0.0015
"""Free way of the tip [m]."""


class Walled(Patient):
    """As patient; nobody has to go anywhere."""

    name = "walled"
    title = "A wall"

    def reset(self, rng: np.random.Generator) -> None:
        """The wall stands beside where the tip is."""
        super().reset(rng)
        self._x = float(self._world.truth("PSM1").tip[0]) + ROOM

    def jaw_force(self, arm: str) -> NDArray[np.float64] | None:
        """Of the wall, along x of the world."""
        inside = float(self._world.truth(arm).tip[0]) - self._x
        return np.array([-STIFFNESS * max(inside, 0.0), 0.0, 0.0])
