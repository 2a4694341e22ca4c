"""The roll of a handle about its own axis, by swing–twist.

An instrument in a trocar has four degrees of freedom: of a handle's orientation only the roll is
used. Its pitch and yaw are the swing, which is ignored; so there is nothing to align.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from surg_teleop.leaders.leader import HandlePose

Array = NDArray[np.float64]

MIN_TWIST = 1e-3
"""|cos(swing / 2)| must exceed this: swing–twist has no answer where the handle points back."""
MIN_LIVE_TWIST = 0.17
"""The same for a live hand, 160 degrees of swing: near the singularity a little tremor is much
roll. A hand that has turned so far is latched anew."""


def twist_angle(rotations: Array) -> tuple[Array, Array]:
    """Roll of a handle about its own axis (z) since the first sample, by swing–twist.

    R_0^T R = swing · twist(z), twist = 2 atan2(q_z, q_w) of that quaternion.

    Args:
        rotations: (n, 3, 3) handle orientations, third column the handle axis.

    Returns:
        The unwrapped twist (n,) [rad] and its quality (n,): |cos(swing / 2)|, 0 where undefined.
    """
    relative = np.einsum("ji,njk->nik", rotations[0], rotations)
    # tan(twist) from the matrix: q_z / q_w = (r21 - r12) / (1 + r11 + r22 + r33), and both are
    # scaled by cos(swing / 2), so that 2 atan2 needs no normalisation:
    # (r21 - r12, r11 + r22) = (1 + cos swing) (sin twist, cos twist).
    sine = relative[:, 1, 0] - relative[:, 0, 1]
    cosine = relative[:, 0, 0] + relative[:, 1, 1]
    quality = np.sqrt(np.hypot(sine, cosine) / 2.0)
    return np.unwrap(np.arctan2(sine, cosine)), quality


class Handle:
    """A live hand: its position, and its roll since it was latched, sample by sample.

    Args:
        pose: Where it is latched.
    """

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
        # As in twist_angle, for one orientation.
        (a, b, _), (c, d, _), _ = (self._latched.T @ pose.R_VH).tolist()
        sine, cosine = c - b, a + d
        quality = math.sqrt(math.hypot(sine, cosine) / 2.0)
        turn = math.remainder(math.atan2(sine, cosine) - (self.roll - self._offset), math.tau)
        if quality < MIN_LIVE_TWIST:
            # The swing is too large to tell the roll: go on from here, the roll as it is.
            self._latched, self._offset = pose.R_VH, self.roll
            return
        self.roll += turn
