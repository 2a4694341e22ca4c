"""How a true pose differs from the stated one: a registration that is wrong by a known amount."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import surg_core
from surg_core.transforms import axis_angle_to_matrix, make_pose
from surg_sim.arrays import Array


@dataclass(frozen=True)
class PoseError:
    """A shift and a turn of known sizes, in directions drawn by the seed."""

    shift: float  # [m]
    turn: float  # [rad], about the frame's own origin
    seed: int = 0  # of the two directions

    def motion(self) -> Array:
        """The motion D (4, 4) with ``X_true = X_stated D``."""
        towards, about = np.random.default_rng(self.seed).normal(size=(2, 3))
        R = axis_angle_to_matrix(about / np.linalg.norm(about), self.turn)
        return make_pose(self.shift * towards / np.linalg.norm(towards), R)


def with_base_error(cell: surg_core.Cell, error: PoseError | None) -> surg_core.Cell:
    """The cell as it is built: every base but the first arm's is off by the error.

    Each arm's error has directions of its own. What the nodes believe, ``X_WB``, stays.
    """
    if error is None:
        return cell
    arms = dict(cell.arms)
    for k, arm in enumerate(cell.arms.values()):
        if k > 0:
            X_WB = arm.X_WB_stated @ replace(error, seed=error.seed + 1000 * k).motion()
            arms[arm.name] = replace(arm, X_WB_stated=X_WB)
    return replace(cell, arms=arms)
