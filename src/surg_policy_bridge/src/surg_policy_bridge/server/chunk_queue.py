"""The steps that are still to come, by their absolute number.

A chunk of actions replaces what was queued from its first step on, spliced by what has been
executed and not by any guess of a delay: a step whose time is over when it comes is dropped and
counted as late. A step that is being executed already is not changed any more; a newer word on it
is dropped, too, but it is not late.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST = 256
"""Steps that are kept; a chunk that reaches further is cut, for it would be stale by then."""


@dataclass(frozen=True)
class Step:
    """One row of a chunk.

    Attributes:
        number: Grid time at which the arms shall be there.
        row: The action, (A,).
        seq: Of the observation that it answers.
        seen: When that observation was taken [ns].
    """

    number: int
    row: Array
    seq: int
    seen: int


class ChunkQueue:
    """Steps by their number; none before `next` is ever taken in."""

    def __init__(self) -> None:
        self._steps: dict[int, Step] = {}
        self.next = 0
        """The first step that is still to be executed."""
        self._open = 0
        """The first step whose time is not over; at most `next`."""

    def __len__(self) -> int:
        """How many steps are waiting."""
        return len(self._steps)

    def flush(self) -> int:
        """Forget everything; returns how many steps that were."""
        count = len(self._steps)
        self._steps.clear()
        return count

    def splice(self, first: int, rows: Array, seq: int, seen: int) -> int:
        """Take a chunk in.

        Args:
            first: Number of its first step.
            rows: (K, A).
            seq: Of the observation that it answers.
            seen: When that observation was taken [ns].

        Returns:
            How many of its steps came too late.
        """
        late = min(max(self._open - first, 0), len(rows))
        begun = min(max(self.next - first, 0), len(rows))
        if begun == len(rows):
            return late  # it says nothing of what is to come
        begin = first + begun
        self._steps = {n: step for n, step in self._steps.items() if n < begin}
        for number, row in enumerate(rows[begun:], begin):
            if number < self.next + LONGEST:
                self._steps[number] = Step(number, np.array(row, dtype=np.float64), seq, seen)
        return late

    def take(self, number: int, past: int | None = None) -> Step | None:
        """The step of this number, which is executed now; those before it are not any more.

        Args:
            number: Of the step.
            past: The time of the steps up to this one is over; default: of this step itself.
        """
        self.next = max(self.next, number + 1)
        self._open = max(self._open, (number if past is None else past) + 1)
        step = self._steps.get(number)
        self._steps = {n: each for n, each in self._steps.items() if n >= self.next}
        return step

    def peek(self, number: int) -> Step | None:
        """The step of this number, which stays."""
        return self._steps.get(number)

    def drop_older(self, seen: int) -> int:
        """Forget what answers an observation taken before ``seen`` [ns]; returns how many."""
        kept = {n: step for n, step in self._steps.items() if step.seen >= seen}
        count = len(self._steps) - len(kept)
        self._steps = kept
        return count
