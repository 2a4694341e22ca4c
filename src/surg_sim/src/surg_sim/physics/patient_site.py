"""Where the patient is: the frame in which tasks and room place things."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from surg_sim.arrays import Array


@dataclass(frozen=True)
class Site:
    """Where things are, in the world frame; derived from the arms' trocars and home axes."""

    work: Array  # work point, WORK_DEPTH behind the trocar along the home shaft axis, (3,) [m]
    trocar: Array  # trocar point, (3,) [m]
    base: Array  # origin of the arm's base, (3,) [m]
    # Patient axes as columns, (3, 3): z up, y horizontal as the endoscope looks. Where no arm holds
    # it, x points away from the robot.
    R: Array
    ports: Array  # trocar points of all arms, the instrument's first, (k, 3) [m]
    bases: Array  # origins of their bases, in the same order, (k, 3) [m]

    def place(self, offset: Iterable[float]) -> Array:
        """World position of a point given in patient axes from the work point [m], (3,)."""
        return np.asarray(self.work + self.R @ np.asarray(list(offset)))

    def local(self, point: Array) -> Array:
        """The inverse of ``place``."""
        return np.asarray(self.R.T @ (point - self.work))
