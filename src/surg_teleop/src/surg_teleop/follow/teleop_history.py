"""What a tick of the teleoperation needs to know of the ticks before."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from surg_core.hand.leader_sample import LeaderSample

NEVER = -math.inf
"""[s] Before every time of the steady clock."""


@dataclass(frozen=True)
class TeleopHistory:
    """Edges of the buttons and requests; times on the steady clock [s]."""

    ticked: float = NEVER  # time of the last tick
    leader: float = NEVER  # stamp of the last good sample
    # those that were down in it; None: there is a gap between it and now
    buttons: frozenset[str] | None = None
    requested: float = NEVER  # the operator's last request to follow
    enabled: float = NEVER  # the last ``enable``
    paused: float = NEVER  # when the last ``pause`` was sent
    held: float = NEVER  # when the last engagement ended

    def heard(self, sample: LeaderSample, need_present: bool) -> TeleopHistory:
        """After a good sample: button edges become requests, or cancel one."""
        before, buttons = self.buttons, sample.buttons
        requested = self.requested
        if before is not None:
            released = "clutch" in before - buttons
            returned = need_present and "present" in buttons - before
            if released or returned:
                requested = self.ticked
            if "clutch" in buttons:
                requested = NEVER
        return replace(self, buttons=buttons, requested=requested)

    def gap(self) -> TeleopHistory:
        """After a gap: neither edges across it nor earlier requests count."""
        return replace(self, buttons=None, requested=NEVER)
