"""One reading of a leader: what a hand does, in the view frame V.

V has the optical axes of the endoscope's left eye: x right, y down, z away from the viewer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from surg_core.arm_view import Array

BUTTONS = frozenset(
    {
        "clutch",  # held: the hand moves, the instrument does not
        "camera",  # held: the hand moves the endoscope
        "enable",  # pressed: teleoperation on or off
        "record",  # pressed: recording on or off
        "present",  # held: the operator is there (head sensor, dead-man grip)
        "rate",  # pressed while clutched: the other mapping, of a leader that offers both
        "lock_rotation",  # held: the roll stays
        "lock_translation",  # held: the tip stays
    }
)
"""Names of buttons; a sample holds those that are down."""

UNIT_TOLERANCE = 1e-3
"""Largest deviation of a squared quaternion's length from 1, as left by single precision. A larger
one means a broken driver, and its roll would be wrong."""


@dataclass(frozen=True)
class HandlePose:
    """Pose of the handle in V; only its motion counts, so the origin is arbitrary.

    Attributes:
        p_VH: (3,) handle [m].
        q_VH: (4,) its orientation x, y, z, w. Its z is the handle axis, about which the hand rolls;
            it points out of the hand, like the instrument.
    """

    p_VH: Array
    q_VH: Array

    def finite(self) -> bool:
        """Whether every number is finite and q_VH is a unit quaternion."""
        return _is_vector(self.p_VH) and _is_unit(self.q_VH)


@dataclass(frozen=True)
class HandRate:
    """Commanded rate: in the picture, or about the trocar (spherical mode).

    Attributes:
        v_V: (3,) velocity of the tip in V [m/s] at the default scale; other scales change it in
            proportion. Zeros in spherical mode.
        roll: Rate of the shaft's roll [rad/s], positive clockwise seen along the shaft into the
            patient.
        spherical: None, or (3,) rates of yaw, pitch [rad/s] and insertion [m/s] of the virtual
            joints, the paper's spherical mode; v_V is then ignored.
        tilt: None, or (2,) rates about x and y of V [rad/s]. They turn a wristed tip only, with the
            roll about z of V; without them the roll is about the tool's own axis.
    """

    v_V: Array
    roll: float = 0.0
    spherical: Array | None = None
    tilt: Array | None = None

    def finite(self) -> bool:
        """Whether every number is finite."""
        return (
            _is_vector(self.v_V)
            and math.isfinite(self.roll)
            and (self.spherical is None or _is_vector(self.spherical))
            and (self.tilt is None or math.isfinite(float(self.tilt.sum())))
        )


@dataclass(frozen=True)
class LeaderSample:
    """One reading of a leader.

    Attributes:
        stamp: Receipt on the steady clock of ``read``'s ``now`` [s].
        pose: Of the handle; None: the leader has none.
        rate: Commanded velocity; None: the leader has none. A leader may provide both.
        grip: 0 closed to 1 open; None: it has no gripper.
        buttons: Those of BUTTONS that are down.
        problem: Why the leader must not be followed although it sends (for example, its own state
            is not ENABLED), and what to do; empty: it may.
    """

    stamp: float
    pose: HandlePose | None = None
    rate: HandRate | None = None
    grip: float | None = None
    buttons: frozenset[str] = frozenset()
    problem: str = ""

    def finite(self) -> bool:
        """Whether all numbers of the sample are valid."""
        return (
            math.isfinite(self.stamp)
            and (self.pose is None or self.pose.finite())
            and (self.rate is None or self.rate.finite())
            and (self.grip is None or math.isfinite(self.grip))
        )


def _is_vector(value: Array) -> bool:
    return value.shape == (3,) and math.isfinite(float(value.sum()))


def _is_unit(value: Array) -> bool:
    return value.shape == (4,) and abs(float(value @ value) - 1.0) <= UNIT_TOLERANCE  # not NaN
