"""When a policy has been silent, idle or wrong for too long. Times are integer nanoseconds."""

from __future__ import annotations

from dataclasses import dataclass

from surg_policy_bridge.server.policy_arm import SECOND

SILENCE = 150_000_000
"""[ns] A client that pings every 50 ms and has not been heard for longer is not there."""
MAX_OBS_AGE = 600_000_000
"""[ns] A step is executed only while the observation that it answers is younger."""
EMPTY = 2 * SECOND
"""[ns] Without a step to execute for longer, the arms are paused."""
REJECTS = 3
"""Rejected steps in a row that pause the arms."""
CAMERA_PERIODS = 3
"""Periods of a camera that may pass without a new picture (F08)."""
PRESENCE = SECOND // 4
"""[ns] A dead-man is repeated 20 times a second; one that has not been for longer is let go. The
teleoperation's limit, too (surg_teleop.follow.arm_switch.PEDAL_SILENCE)."""


@dataclass
class Patience:
    """A limit on how long something may last.

    Attributes:
        limit: [ns]
        since: When it began [ns]; None: it does not last.
    """

    limit: int
    since: int | None = None

    def lasts(self, now: int) -> None:
        """It lasts; the first call counts."""
        if self.since is None:
            self.since = now

    def over(self) -> None:
        """It is over."""
        self.since = None

    def exceeded(self, now: int) -> bool:
        """Whether it has lasted for longer than the limit."""
        return self.since is not None and now - self.since > self.limit


class Presence:
    """Is anybody at the controls? One source that is pressed, and says so again, is enough."""

    def __init__(self) -> None:
        self._down: dict[str, int] = {}

    def press(self, source: str, down: bool, now: int) -> None:
        """A source says whether it is pressed; it speaks for itself alone."""
        if down:
            self._down[source] = now
        else:
            self._down.pop(source, None)

    def there(self, now: int) -> bool:
        """Whether somebody is: the word of a source that has died does not last."""
        return any(now - at <= PRESENCE for at in self._down.values())
