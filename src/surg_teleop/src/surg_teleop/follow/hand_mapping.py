"""How a leader's hand maps onto an arm's tip: always relative to a moment at which it was latched.

So engaging never moves the arm, and where the hand's own zero lies does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from surg_core.arm_view import Array


@dataclass(frozen=True)
class Mapping:
    """p = p_arm_0 + scale R_RL (p_leader - p_leader_0), roll = roll_arm_0 + roll_leader - roll_0.

    Roll is not scaled: a turn of the hand is a turn of the instrument.
    """

    scale: float  # arm metres per leader metre, above 0
    p_leader_0: Array  # (3,) leader position when latched [m]
    roll_leader_0: float  # leader roll when latched [rad]
    p_arm_0: Array  # (3,) tip when latched, in the rcm frame R [m]
    roll_arm_0: float  # shaft roll when latched [rad]
    # (3, 3) the leader's axes in the rcm frame; the identity where they are the same
    R_RL: Array = field(default_factory=lambda: np.eye(3))

    def position(self, p_leader: Array) -> Array:
        """Tip in the rcm frame [m] for leader positions (..., 3) [m]."""
        p_arm: Array = self.p_arm_0 + self.scale * ((p_leader - self.p_leader_0) @ self.R_RL.T)
        return p_arm

    def roll(self, roll_leader: float) -> float:
        """Shaft roll [rad] for a leader roll [rad]."""
        return self.roll_arm_0 + (roll_leader - self.roll_leader_0)
