"""The jaw follows the grip of the hand and never opens by itself.

As on the dVRK: at an engagement grip and jaw seldom agree, so the jaw moves slowly until both have
met within 2 degrees, and fast from then on. Until then the jaw closes towards the grip, but opens
only by as much as the grip has opened since the engagement. So only the hand releases what the jaw
holds.
"""

from __future__ import annotations

import math

from surg_core.arm_view import JawRange

SLOW = 0.5
"""[rad/s] Rate until jaw and grip have met; from open to closed in one or two seconds."""
MET = math.radians(2.0)
"""[rad] Largest difference at which jaw and grip count as met."""


class JawFollower:
    """Set-point of the jaw, tick by tick.

    Args:
        fast: Rate once jaw and grip have met [rad/s].
        angle: Present set-point of the jaw [rad].
        grip: Present grip, 0 closed to 1 open.
    """

    def __init__(self, jaw: JawRange, fast: float, angle: float, grip: float) -> None:
        self._jaw, self._fast = jaw, fast
        self.angle = min(max(angle, jaw.min), jaw.max)
        """Set-point of the jaw [rad]."""
        self._grip_angle = self._angle_of(grip)
        self._opening_left = 0.0  # opened by the hand and not yet by the jaw [rad]
        self.met = abs(self._grip_angle - self.angle) <= MET
        """Whether jaw and grip have met since the engagement."""

    def tick(self, grip: float, dt: float) -> float:
        """Set-point of the jaw [rad], `dt` [s] later, for a grip of 0 (closed) to 1 (open)."""
        wanted = self._angle_of(grip)
        self._opening_left = max(0.0, self._opening_left + wanted - self._grip_angle)
        self._grip_angle = wanted
        step = (self._fast if self.met else SLOW) * dt
        if wanted < self.angle:
            self.angle = max(wanted, self.angle - step)
        else:
            opening = min(wanted - self.angle, step, self._opening_left)
            self.angle += opening
            self._opening_left -= opening
        self.met = self.met or abs(wanted - self.angle) <= MET
        return self.angle

    def _angle_of(self, grip: float) -> float:
        return self._jaw.min + min(max(grip, 0.0), 1.0) * (self._jaw.max - self._jaw.min)
