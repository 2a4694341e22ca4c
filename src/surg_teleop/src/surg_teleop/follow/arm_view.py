"""An arm as its senders see it: what it says, and what may be asked of it.

Values only: no ROS, no clock. Poses are in the arm's rcm frame R (docs/reference/conventions.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from surg_core import State as ArmState

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ArmView:
    """What a sender looks at in one control cycle; vectors in the rcm frame R.

    Attributes:
        stamp_ns: Stamp of the cycle [ns].
        state: Operating state.
        homed: Home is set.
        busy: A move is under way.
        reason: Why the arm is PAUSED, in FAULT or held.
        refused: Commands refused so far.
        p_set: (3,) tip set-point [m].
        p_tip: (3,) measured tip [m].
        roll_set: Roll of the set-point [rad].
        jaw_set: Jaw set-point [rad]; not a number: the arm does not know its jaw.
        holder: Caller id of the node that holds the arm; empty: nobody does.
        stream: Caller id of the node whose servo_cp the arm obeys; empty: it obeys none.
        R_WR: (3, 3) the rcm frame in the world of the cell: its base in the world, and R in it.
        received: Receipt on the steady clock of its reader [s].
    """

    stamp_ns: int
    state: ArmState
    homed: bool
    busy: bool
    reason: str
    refused: int
    p_set: Array
    p_tip: Array
    roll_set: float = 0.0
    jaw_set: float = math.nan
    holder: str = ""
    stream: str = ""
    R_WR: Array = field(default_factory=lambda: np.eye(3))
    received: float = 0.0


@dataclass(frozen=True)
class Pose:
    """A tip pose in the rcm frame.

    Attributes:
        p: (3,) tip [m].
        q: (4,) orientation x, y, z, w: the tool's z along the shaft, rolled about it.
    """

    p: Array
    q: Array


@dataclass
class Commands:
    """What to send in answer to one cycle. Empty members are not sent.

    Attributes:
        stamp_ns: Stamp of the commands: the cycle they are meant for [ns].
        state: A state_command.
        move_cp: A pose to go to.
        servo_cp: A pose of the stream.
        servo_jp: (4,) yaw, pitch [rad], insertion [m], roll [rad] of the stream.
        jaw: Jaw angle [rad].
        hold: True: stop where you are.
        claim: True: from now on nobody else may move the arm.
    """

    stamp_ns: int = 0
    state: str | None = None
    move_cp: Pose | None = None
    servo_cp: Pose | None = None
    servo_jp: Array | None = None
    jaw: float | None = None
    hold: bool = False
    claim: bool = False


@dataclass(frozen=True)
class Jaw:
    """Range of an instrument's jaw [rad]; min is closed."""

    min: float
    max: float


def tip_pose(p: Array, roll: float) -> Pose:
    """Pose of a tip at p with an absolute roll: R = minimal rotation (z to shaft) · Rz(roll).

    Args:
        p: (3,) tip in the rcm frame [m], not above the trocar.
        roll: Absolute roll [rad].

    Returns:
        The pose; its quaternion has unit length.
    """
    px, py, pz = p.tolist()
    # The minimal rotation from z to p is (z x p, |p| + z . p), normalised; then Rz(roll).
    x, y, w = -py, px, math.hypot(px, py, pz) + pz
    length = math.hypot(x, y, w)
    x, y, w = x / length, y / length, w / length
    c, n = math.cos(roll / 2.0), math.sin(roll / 2.0)
    return Pose(p=p, q=np.array([x * c + y * n, y * c - x * n, w * n, w * c]))


def virtual_joints(p: Array, roll: float) -> Array:
    """The same as four joints: s = (sin yaw cos pitch, sin pitch, cos yaw cos pitch).

    Args:
        p: (3,) tip in the rcm frame [m].
        roll: Absolute roll [rad].

    Returns:
        (4,) yaw, pitch [rad], insertion [m], roll [rad].
    """
    px, py, pz = p.tolist()
    depth = math.hypot(px, py, pz)
    return np.array([math.atan2(px, pz), math.asin(py / depth), depth, roll])
