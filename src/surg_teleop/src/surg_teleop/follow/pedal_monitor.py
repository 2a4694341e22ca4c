"""Pedals and presence sensors beside the leaders; a pressed button counts for every leader."""

from __future__ import annotations

import math
from dataclasses import replace

from surg_core.contract import PRESENCE_TIMEOUT
from surg_core.hand.leader_sample import LeaderSample

PEDAL_REPEATS = 5
"""A source that repeats the same state so often in a row is taken to repeat it always."""

Button = tuple[str, str]
"""Source and name of a button."""


class PedalMonitor:
    """State of all buttons, and which repeating sources have fallen silent.

    A source that repeats unchanged states is supervised like a leader. One that sends changes only
    cannot be.
    """

    def __init__(self) -> None:
        self._down: set[Button] = set()
        self._last: dict[Button, tuple[bool, float, int]] = {}  # state, time, repeats
        self._alive: dict[str, float] = {}  # last message of every source that repeats

    def press(self, source: str, button: str, down: bool, now: float) -> bool:
        """A source reports a button, its own only; returns whether it has changed."""
        before, when, repeats = self._last.get((source, button), (None, -math.inf, 0))
        repeats = repeats + 1 if down is before and now - when <= PRESENCE_TIMEOUT else 0
        if source in self._alive or repeats >= PEDAL_REPEATS:
            self._alive[source] = now
        self._last[source, button] = (down, now, repeats)
        if down:
            self._down.add((source, button))
        else:
            self._down.discard((source, button))
        return down is not before

    def problem(self, now: float) -> str:
        """Which sources are silent, and what to do; empty if none is."""
        silent = self._silent(now)
        if not silent:
            return ""
        return (
            f"the buttons of {', '.join(silent)} are silent; restart that node, or press enable to "
            "continue without it"
        )

    def forget(self, now: float) -> None:
        """Continue without the silent sources; their buttons count as released."""
        for source in self._silent(now):
            del self._alive[source]
            self._down = {button for button in self._down if button[0] != source}
            self._last = {
                button: last for button, last in self._last.items() if button[0] != source
            }

    def merge(self, sample: LeaderSample | None, now: float) -> LeaderSample | None:
        """The sample with these buttons; it carries a problem while a source is silent."""
        if sample is None:
            return None
        if problem := self.problem(now):
            sample = replace(sample, problem=sample.problem or problem)
        if not self._down:
            return sample
        return replace(sample, buttons=sample.buttons | {button for _, button in self._down})

    def _silent(self, now: float) -> list[str]:
        return sorted(s for s, heard in self._alive.items() if now - heard > PRESENCE_TIMEOUT)
