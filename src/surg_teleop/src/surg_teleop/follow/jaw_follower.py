"""The jaw follows a ghost of the hand's grip; it never opens by itself.

As on the dVRK: at an engagement hand and jaw seldom agree, so the ghost goes slowly until they have
met within 2 degrees, and fast from then on. Beyond the dVRK: while they have not met the jaw may
close towards the hand, but it opens only by as much as the hand itself has opened since. What a
jaw holds is let go by the hand, never by an engagement.
"""

from __future__ import annotations

import math

from surg_teleop.follow.arm_view import Jaw

SLOW = 0.5
"""[rad/s] until hand and jaw have met; from open to closed in a second or two."""
MET = math.radians(2.0)
"""[rad] Hand and jaw agree."""


class JawGhost:
    """Where the jaw shall be, tick by tick.

    Args:
        jaw: Its range.
        fast: Rate once hand and jaw have met [rad/s].
        angle: Where the jaw is commanded now [rad].
        grip: The hand now, 0 closed to 1 open.
    """

    def __init__(self, jaw: Jaw, fast: float, angle: float, grip: float) -> None:
        self._jaw, self._fast = jaw, fast
        self.angle = min(max(angle, jaw.min), jaw.max)
        """Where the jaw shall be [rad]."""
        self._wanted = self._angle_of(grip)
        self._opened = 0.0  # by the hand and not yet by the jaw [rad]
        self.met = abs(self._wanted - self.angle) <= MET
        """Whether hand and jaw have met since the engagement."""

    def tick(self, grip: float, dt: float) -> float:
        """One tick.

        Args:
            grip: The hand, 0 closed to 1 open.
            dt: Time since the last tick [s].

        Returns:
            Where the jaw shall be [rad].
        """
        wanted = self._angle_of(grip)
        self._opened = max(0.0, self._opened + wanted - self._wanted)
        self._wanted = wanted
        step = (self._fast if self.met else SLOW) * dt
        if wanted < self.angle:
            self.angle = max(wanted, self.angle - step)
        else:
            opening = min(wanted - self.angle, step, self._opened)
            self.angle += opening
            self._opened -= opening
        self.met = self.met or abs(wanted - self.angle) <= MET
        return self.angle

    def _angle_of(self, grip: float) -> float:
        return self._jaw.min + min(max(grip, 0.0), 1.0) * (self._jaw.max - self._jaw.min)
