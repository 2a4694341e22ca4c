"""One arm's part of a policy's action, and its rcm frame.

Values only. Vectors are in the arm's trocar frame R (docs/reference/conventions.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_core.arm_view import ArmCommands, ArmView, TipPose

Array = NDArray[np.float64]


def rcm_frame(view: ArmView, X_WB: Array) -> Array:
    """X_WR (4, 4) of one arm, for ``observation.rcm_frame``; ``X_WB`` is the pose of its base."""
    X_BR = np.eye(4)
    X_BR[:3, :3], X_BR[:3, 3] = view.R_BR, view.p_BRcm
    return np.asarray(X_WB @ X_BR)


@dataclass(frozen=True)
class Target:
    """Target of one arm at a grid time."""

    p: Array  # tip, (3,) [m]
    roll: float  # [rad]
    jaw: float  # [rad]

    @classmethod
    def of(cls, row: Array) -> Target:
        """The target that the five numbers of an action describe."""
        return cls(np.array(row[:3], dtype=np.float64), float(row[3]), float(row[4]))

    @property
    def row(self) -> Array:
        """The five numbers of the action."""
        return np.array([*self.p, self.roll, self.jaw])

    def toward(self, other: Target, share: float) -> Target:
        """Interpolate to another target, ``share`` from 0 to 1; the roll takes the shorter way."""
        turn = math.remainder(other.roll - self.roll, math.tau)
        return Target(
            self.p + share * (other.p - self.p),
            self.roll + share * turn,
            self.jaw + share * (other.jaw - self.jaw),
        )

    def commands(self) -> ArmCommands:
        """Commands that stream this target."""
        return ArmCommands(servo_cp=TipPose(self.p, self.roll), jaw=self.jaw)
