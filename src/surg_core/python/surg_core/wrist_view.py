"""The wrist of an arm as its clients see it in a cycle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from surg_core.transforms import matrix_to_quaternion_xyzw
from surg_core.wrist_joints import wrist_centres

if TYPE_CHECKING:
    from surg_core._core import WristGeometry, WristOutputs

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class WristView:
    """The wrist in one cycle, bit for bit as in surg_msgs/Cycle.

    Attributes:
        geometry: Lengths, and the turn that is known from homing on.
        measured: (2,) pitch and yaw [rad].
        set: Their set-point.
        goal: Those of the newest accepted target.
        q_RTip: (4,) measured orientation x, y, z, w of the tool frame in the trocar frame.
        q_RSet: Of the set-point.
        q_RGoal: Of the newest accepted target.
    """

    geometry: WristGeometry
    measured: Array
    set: Array
    goal: Array
    q_RTip: Array
    q_RSet: Array
    q_RGoal: Array

    @classmethod
    def of(cls, out: WristOutputs) -> WristView:
        """That of a controller in this process."""
        rotations = (out.R_RTip, out.R_RSet, out.R_RGoal)
        turns = (np.array(joints) for joints in (out.q, out.set, out.goal))
        return cls(out.geometry, *turns, *map(matrix_to_quaternion_xyzw, rotations))

    def centre(self, p_RTip: Array, q_RTip: Array, turns: Array) -> Array:
        """(3,) the wrist's centre in R [m], of a tip with these joints (2,) [rad]."""
        return wrist_centres(self.geometry, p_RTip[None], q_RTip[None], turns[None, 1])[0]
