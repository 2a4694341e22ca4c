"""How a leader's hand maps onto an arm's tip: always relative to the moment of engagement.

So engaging never moves the arm, and where the hand's own zero lies does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mapping:
    """p = p_arm + scale (p_leader - p_leader_0), roll = roll_arm + (roll_leader - roll_leader_0).

    The leader's axes are taken as the axes of the arm's rcm frame. Roll is not scaled: a turn of
    the hand is a turn of the instrument.

    Attributes:
        scale: Arm metres per leader metre, above 0.
        p_leader_0: (3,) leader position at engagement [m].
        roll_leader_0: Leader roll at engagement [rad].
        p_arm_0: (3,) tip at engagement, in the rcm frame [m].
        roll_arm_0: Shaft roll at engagement [rad].
    """

    scale: float
    p_leader_0: Array
    roll_leader_0: float
    p_arm_0: Array
    roll_arm_0: float

    def position(self, p_leader: Array) -> Array:
        """Tip in the rcm frame [m] for leader positions (..., 3) [m]."""
        p_arm: Array = self.p_arm_0 + self.scale * (p_leader - self.p_leader_0)
        return p_arm

    def roll(self, roll_leader: float) -> float:
        """Shaft roll [rad] for a leader roll [rad]."""
        return self.roll_arm_0 + (roll_leader - self.roll_leader_0)
