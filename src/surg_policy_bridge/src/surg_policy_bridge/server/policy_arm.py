"""An arm as the model server sees it: what it says, and what is asked of it.

Values only: no ROS, no clock. Vectors are in the arm's rcm frame R
(docs/reference/conventions.md); times are
integer nanoseconds of the caller's clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_core import State as ArmState

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ArmView:
    """One control cycle of an arm.

    Attributes:
        stamp_ns: Stamp of the cycle.
        state: Operating state.
        homed: Home is set.
        reason: Why the arm is PAUSED, in FAULT or held; empty otherwise.
        holder: Caller id of the node that holds the arm; empty: nobody does.
        p_tip: Measured tip, (3,) [m].
        roll: Measured roll [rad].
        jaw: Measured jaw angle [rad]; not a number: the arm does not know it.
        p_set: Set-point of the tip, (3,) [m].
        roll_set: Set-point of the roll [rad].
        jaw_set: Set-point of the jaw [rad].
        rcm_error: Distance of the shaft from its pivot [m].
        refused: Commands that the controller has refused so far.
    """

    stamp_ns: int
    state: ArmState
    homed: bool
    reason: str
    holder: str
    p_tip: Array
    roll: float
    jaw: float
    p_set: Array
    roll_set: float
    jaw_set: float
    rcm_error: float
    refused: int = 0

    def numbers(self) -> list[float]:
        """What ``observation.state`` says of this arm, in the order of `contract.ARM_STATE`."""
        return [*self.p_tip, self.roll, self.jaw, *self.p_set, self.roll_set]


@dataclass(frozen=True)
class Target:
    """Where one arm shall be at a grid time.

    Attributes:
        p: Tip, (3,) [m].
        roll: [rad]
        jaw: [rad]
    """

    p: Array
    roll: float
    jaw: float

    @classmethod
    def of(cls, row: Array) -> Target:
        """From the five numbers of an action."""
        return cls(np.array(row[:3], dtype=np.float64), float(row[3]), float(row[4]))

    @property
    def row(self) -> Array:
        """The five numbers of an action."""
        return np.array([*self.p, self.roll, self.jaw])

    def toward(self, other: Target, share: float) -> Target:
        """The target a share of the way to another; the roll goes the shorter way."""
        turn = math.remainder(other.roll - self.roll, math.tau)
        return Target(
            self.p + share * (other.p - self.p),
            self.roll + share * turn,
            self.jaw + share * (other.jaw - self.jaw),
        )


@dataclass
class ArmCommand:
    """What to send to one arm; empty members are not sent.

    Attributes:
        state: A state_command.
        claim: From now on nobody else may move the arm.
        servo: A pose of the stream, and the jaw.
        hold: Stop where you are.
    """

    state: str = ""
    claim: bool = False
    servo: Target | None = None
    hold: bool = False

    def __bool__(self) -> bool:
        """Whether there is anything to send."""
        return bool(self.state or self.claim or self.servo or self.hold)
