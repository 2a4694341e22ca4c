"""What a bad network does to datagrams of one direction: loss, reordering, duplicates, bursts."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

MOST_HELD = 1000
"""Datagrams that a stalled network keeps; further ones are lost."""


@dataclass
class DatagramChannel:
    """One direction of a network.

    Attributes:
        seed: Of its random choices.
        loss: Share of datagrams that are lost.
        duplicate: Share of datagrams that arrive twice.
        reorder: Share of datagrams that arrive after the next one.
        burst: Number of the next datagrams that are lost in a row.
        stalled: Whether it keeps everything until later.
    """

    seed: int = 1
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    burst: int = 0
    stalled: bool = False
    _late: list[bytes] = field(default_factory=list)
    _held: list[bytes] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def pass_on(self, data: bytes) -> list[bytes]:
        """A datagram goes in; returns what comes out now, in that order."""
        out = self._meet_faults(data)
        if self.stalled:
            self._held = (self._held + out)[:MOST_HELD]
            return []
        return self.release() + out

    def release(self) -> list[bytes]:
        """What a stall has kept."""
        held, self._held = self._held, []
        return held

    def _meet_faults(self, data: bytes) -> list[bytes]:
        if self.burst > 0:
            self.burst -= 1
            return []
        if self.loss and self._random.random() < self.loss:
            return []
        late, self._late = self._late, []
        if self.reorder and not late and self._random.random() < self.reorder:
            self._late = [data]
            return []
        twice = bool(self.duplicate) and self._random.random() < self.duplicate
        return [data, *([data] if twice else []), *late]
