"""What of another program's recording was kept, dropped, converted and assumed."""

from __future__ import annotations

import dataclasses
from collections import Counter
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_recording.recording_errors import EpisodeError

LARGEST_LOSS = 0.01
"""Share of a stream that an import may lose, unless told otherwise."""

Mask = npt.NDArray[np.bool_]


@dataclasses.dataclass
class Ledger:
    """The account of one import. A stream is a topic, a feature or a camera."""

    allowed: float = LARGEST_LOSS
    """Share of each stream that may be lost, 0 to 1."""
    held: Counter[str] = dataclasses.field(default_factory=Counter)
    """Stream → messages, rows or pictures that the source holds."""
    dropped: dict[str, Counter[str]] = dataclasses.field(default_factory=dict)
    """Stream → reason → messages, rows or pictures."""
    converted: dict[str, str] = dataclasses.field(default_factory=dict)
    """Stream → from what to what."""
    assumed: list[str] = dataclasses.field(default_factory=list)
    """What the source does not state, and what was taken instead."""

    @property
    def kept(self) -> dict[str, int]:
        """Stream → messages, rows or pictures that arrived."""
        return {s: n - sum(self.dropped.get(s, {}).values()) for s, n in self.held.items()}

    def hold(self, stream: str, count: int) -> None:
        """Count what the source holds."""
        self.held[stream] += count

    def drop(self, stream: str, reason: str, count: int = 1) -> None:
        """Count what does not arrive, with its reason."""
        if count:
            self.dropped.setdefault(stream, Counter())[reason] += count

    def sieve(self, stream: str, bad: Mask, reason: str, good: Mask) -> Mask:
        """``good`` without what is bad, of which those that were good are counted as dropped."""
        self.drop(stream, reason, int((bad & good).sum()))
        return good & ~bad

    def assume(self, words: str) -> None:
        """Add an assumption, once."""
        if words not in self.assumed:
            self.assumed.append(words)

    def check(self) -> None:
        """Refuse a stream that has lost more than is allowed.

        Raises:
            EpisodeError: Names stream, reasons and the option that allows it.
        """
        for stream, reasons in self.dropped.items():
            lost, held = sum(reasons.values()), self.held[stream]
            if lost > self.allowed * held:
                why = "; ".join(f"{count} {reason}" for reason, count in reasons.most_common())
                raise EpisodeError(
                    f"{stream}: {lost} of {held} would be lost ({why}); allowed:"
                    f" {100 * self.allowed:g} %. --allow-loss PERCENT allows more"
                )

    def stated(self) -> dict[str, Any]:
        """For the manifest."""
        return {
            "kept": self.kept,
            "dropped": {stream: dict(reasons) for stream, reasons in self.dropped.items()},
            "converted": dict(self.converted),
            "assumed": list(self.assumed),
        }
