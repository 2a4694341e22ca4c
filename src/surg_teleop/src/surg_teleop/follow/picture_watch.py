"""Is the picture alive? A hand must not be led by a picture of some time ago (F08).

Pure: stamps, fingerprints and times in, a sentence out. The arm is not stopped by it: the operator,
who sees that nothing moves, is told why.
"""

from __future__ import annotations

from dataclasses import dataclass, field

PERIODS = 3.0
"""A picture that is later than that many of its periods has stalled."""
LONGEST = 1.0
"""[s] No period is longer."""


@dataclass
class PictureWatch:
    """Watches one camera.

    Attributes:
        name: The camera's, for messages.
        period: Between two pictures, as seen lately [s].
    """

    name: str
    period: float = 0.05
    _changed: float | None = field(default=None, repr=False)
    _stamp: int = field(default=0, repr=False)
    _fingerprint: int = field(default=0, repr=False)
    _arrived: float | None = field(default=None, repr=False)

    def picture(self, now: float, stamp_ns: int, fingerprint: int) -> None:
        """A picture has come.

        Args:
            now: Steady clock [s].
            stamp_ns: Its own stamp [ns].
            fingerprint: Of its pixels: a scene with a living camera is never twice the same.
        """
        if self._arrived is not None:
            spacing = min(now - self._arrived, LONGEST)
            self.period += 0.1 * (spacing - self.period)
        self._arrived = now
        if stamp_ns > self._stamp and fingerprint != self._fingerprint:
            self._changed = now
        self._stamp, self._fingerprint = stamp_ns, fingerprint

    def problem(self, now: float) -> str:
        """Empty, or what the operator must know."""
        if self._changed is None or self._arrived is None:
            return ""  # a camera that never was has no picture to be deceived by
        age = now - self._changed
        if age <= PERIODS * self.period:
            return ""
        stalled = now - self._arrived > PERIODS * self.period
        what = "sends nothing" if stalled else "shows the same picture"
        return (
            f"the picture is {age:.1f} s old ({self.name} {what}): do not move; check the camera "
            "and its cable"
        )
