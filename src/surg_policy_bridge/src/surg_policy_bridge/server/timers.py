"""Timeouts of the model server. Times are integer nanoseconds."""

from __future__ import annotations

from dataclasses import dataclass

from surg_core.contract import PRESENCE_TIMEOUT, SECOND_NS

SILENCE = 150_000_000
"""[ns] Timeout of a client, which pings every 50 ms."""
MAX_OBS_AGE = 600_000_000
"""[ns] A step is executed only while the observation that it answers is not older."""
EMPTY = 2 * SECOND_NS
"""[ns] The arms are paused after this time without a step."""
REJECTS = 3
"""Rejected steps in a row that pause the arms."""
PRESENCE_NS = round(PRESENCE_TIMEOUT * SECOND_NS)
"""[ns] A dead-man that has not been repeated for longer is released."""
CAMERA_PERIODS = 3
"""Camera periods without a new picture that count as a stall (F08)."""


@dataclass
class Timeout:
    """A limit [ns] on how long something may last; it began at ``since`` [ns], None: it is off."""

    limit: int
    since: int | None = None

    def start(self, now: int) -> None:
        """It begins now, unless it has begun already."""
        if self.since is None:
            self.since = now

    def clear(self) -> None:
        """It has ended."""
        self.since = None

    def exceeded(self, now: int) -> bool:
        """Whether it has lasted for longer than the limit."""
        return self.since is not None and now - self.since > self.limit


class OperatorPresence:
    """Whether the operator is at the controls: one pressed, live source is enough."""

    def __init__(self) -> None:
        self._pressed: dict[str, int] = {}

    def press(self, source: str, down: bool, now: int) -> None:
        """A source reports its own state."""
        if down:
            self._pressed[source] = now
        else:
            self._pressed.pop(source, None)

    def detected(self, now: int) -> bool:
        """Whether any source is pressed; silent sources do not count."""
        return any(now - at <= PRESENCE_NS for at in self._pressed.values())
