"""The roll of a handle about its own axis, by swing–twist.

An instrument in a trocar has four degrees of freedom: of a handle's orientation only the roll is
used. Its pitch and yaw are the swing, which is ignored; so there is nothing to align.
"""

from __future__ import annotations

import math

from surg_core.arm_view import Array
from surg_core.hand.leader_sample import HandlePose
from surg_core.transforms import twist_angle

MIN_TWIST = 1e-3
"""|cos(swing / 2)| must exceed this: swing–twist has no answer where the handle points back."""
MIN_LIVE_TWIST = 0.17
"""The same for a live hand, 160 degrees of swing: near the singularity a little tremor is much
roll. A hand that has turned so far is latched anew."""


class Handle:
    """A live hand: its position, and its roll since it was latched, sample by sample."""

    def __init__(self, pose: HandlePose) -> None:
        self._latched = pose.R_VH
        self._offset = 0.0
        self.p: Array = pose.p_VH
        """(3,) newest position in V [m]."""
        self.roll = 0.0
        """Roll since the first sample, unwrapped [rad]."""

    def move(self, pose: HandlePose) -> None:
        """The next sample."""
        self.p = pose.p_VH
        angle, quality = twist_angle(self._latched.T @ pose.R_VH)
        turn = math.remainder(float(angle) - (self.roll - self._offset), math.tau)
        if quality < MIN_LIVE_TWIST:
            # The swing is too large to tell the roll: go on from here, the roll as it is.
            self._latched, self._offset = pose.R_VH, self.roll
            return
        self.roll += turn
