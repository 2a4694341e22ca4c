"""Detects a stalled or frozen camera picture (F08).

Pure: stamps, checksums and times in, a message out. It does not stop the arm: the operator sees
that nothing moves, and is told why.
"""

from __future__ import annotations

from dataclasses import dataclass, field

PERIODS = 3.0
"""A picture older than this many of its periods is stale."""
LONGEST = 1.0
"""[s] Upper bound of the estimated period."""


@dataclass
class PictureWatch:
    """Watches one camera."""

    name: str  # name of the camera, for messages
    period: float = 0.05  # estimated time between two pictures [s]
    _changed: float | None = field(default=None, repr=False)
    _stamp: int = field(default=0, repr=False)
    _checksum: int = field(default=0, repr=False)
    _arrived: float | None = field(default=None, repr=False)

    def picture(self, now: float, stamp_ns: int, checksum: int) -> None:
        """A picture has arrived; the checksum of a live camera's pixels always changes."""
        if self._arrived is not None:
            spacing = min(now - self._arrived, LONGEST)
            self.period += 0.1 * (spacing - self.period)
        self._arrived = now
        if stamp_ns > self._stamp and checksum != self._checksum:
            self._changed = now
        self._stamp, self._checksum = stamp_ns, checksum

    def problem(self, now: float) -> str:
        """Message for the operator; empty if the picture is live, or there never was one."""
        if self._changed is None or self._arrived is None:
            return ""
        age = now - self._changed
        if age <= PERIODS * self.period:
            return ""
        stalled = now - self._arrived > PERIODS * self.period
        symptom = "sends no pictures" if stalled else "repeats the same picture"
        return (
            f"the picture is {age:.1f} s old ({self.name} {symptom}); do not move; check the "
            "camera and its cable"
        )
