"""One arm's part of a policy's action, and its rcm frame.

Values only. Vectors are in the arm's trocar frame R (docs/reference/conventions.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from surg_core import WristGeometry, make_pose
from surg_core.action_space import commands_of
from surg_core.arm_view import ArmCommands, ArmView

Array = NDArray[np.float64]


def rcm_frame(view: ArmView, X_WB: Array) -> Array:
    """X_WR (4, 4) of one arm, for ``observation.rcm_frame``; ``X_WB`` is the pose of its base."""
    return np.asarray(X_WB @ make_pose(view.p_BRcm, view.R_BR))


@dataclass(frozen=True)
class Target:
    """Target of one arm at a grid time."""

    p: Array
    """Of the shaft's end, the tip or the wrist's centre, (3,) [m]."""
    roll: float  # [rad]
    jaw: float  # [rad]
    turns: Array = field(default_factory=lambda: np.zeros(0))
    """Pitch and yaw of the wrist (2,) [rad]; without numbers where there is none."""
    wrist: WristGeometry | None = None

    @classmethod
    def of(cls, row: Array, wrist: WristGeometry | None = None) -> Target:
        """From the numbers of a target of ``surg_core.action_space``."""
        numbers = np.array(row, dtype=np.float64)
        return cls(numbers[:3], float(numbers[3]), float(numbers[-1]), numbers[4:-1], wrist)

    @classmethod
    def held(cls, view: ArmView) -> Target:
        """The set-point of an arm."""
        return cls.of(view.held_target, view.wrist_geometry)

    @property
    def row(self) -> Array:
        """The numbers of the target."""
        return np.array([*self.p, self.roll, *self.turns, self.jaw])

    def toward(self, other: Target, share: float) -> Target:
        """Interpolate to another target, ``share`` from 0 to 1; the roll takes the shorter way."""
        turn = math.remainder(other.roll - self.roll, math.tau)
        return Target(
            self.p + share * (other.p - self.p),
            self.roll + share * turn,
            self.jaw + share * (other.jaw - self.jaw),
            self.turns + share * (other.turns - self.turns),
            self.wrist,
        )

    def commands(self) -> ArmCommands:
        """Commands that stream this target."""
        return commands_of(self.wrist, self.row)
