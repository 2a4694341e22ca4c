"""Between joints and encoders: the cables' constant matrix, gears, signs and what homing found."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from surg_core.checked_document import FloatArray
from surg_hardware.drive.drive_file import DriveFile


class Coupling:
    """Angles of the joints, of the motors behind their gears, and of the encoders [rad].

    Args:
        drive: Of n motors.
        offsets: (n,) encoders where the motors are at zero [rad].
    """

    def __init__(self, drive: DriveFile, offsets: FloatArray) -> None:
        self._joints = drive.joints
        self._C, self._inverse = drive.coupling, np.linalg.inv(drive.coupling)
        self._gear = np.array([motor.sign * motor.gear for motor in drive.motors])
        self._offsets = offsets
        self._lower = np.array([motor.lower for motor in drive.motors])
        self._upper = np.array([motor.upper for motor in drive.motors])

    def joints(self, encoders: FloatArray) -> FloatArray:
        """(n,) angles of the joints from those of the encoders."""
        return self._C @ ((encoders - self._offsets) / self._gear)

    def rates(self, encoder_rates: FloatArray) -> FloatArray:
        """(n,) velocities of the joints from those of the encoders [rad/s]."""
        return self._C @ (encoder_rates / self._gear)

    def encoders(self, joints: FloatArray) -> FloatArray:
        """(n,) angles of the encoders where the joints have these, or their limits."""
        within = np.clip(joints, self._lower, self._upper)
        return self._offsets + self._gear * (self._inverse @ within)

    def goal(self, before: FloatArray, named: Mapping[str, float]) -> FloatArray:
        """(n,) goal of the joints: what was named, and for the others the goal of before.

        Values that are not finite, and joints that the drive does not have, are left out.
        """
        pairs = zip(self._joints, before, strict=True)
        found = [named.get(joint, old) for joint, old in pairs]
        return np.where(np.isfinite(found), found, before)

    def opened(self, joints: FloatArray) -> FloatArray:
        """(n,) the same joints with open jaws."""
        jaw = self._joints.index("jaw")
        found = joints.copy()
        found[jaw] = self._upper[jaw]
        return found
