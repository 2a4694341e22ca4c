"""Queue of future steps, by their absolute number.

A chunk replaces the queue from its first step on. Steps are placed by absolute number, not by an
assumed delay: a step whose time is over when it arrives is dropped and counted as late. A step that
is being executed does not change any more; a newer version of it is dropped but is not late.

A chunk that is late in part was computed before the newest steps were executed, so it need not go
on where the arm is: it takes over by `plan_shares`.

An arm at rest waits for its first chunk, so that chunk is moved in time instead of cut: its middle
may be too far from the arm to begin with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST = 256
"""Capacity in steps. A chunk that reaches further is cut; its end would be stale by then."""


def plan_shares(steps: int) -> Array:
    """Shares of the former plan in the first steps (K,) of a late chunk.

    They fall from 1 at the step before to 0 behind the last, soonest at once: the soft mask of
    Black, Galliker, Levine, "Real-Time Execution of Action Chunking Flow Policies" (2025), applied
    to the rows themselves, so it needs no gradient of a policy.
    """
    left = 1.0 - np.arange(1, steps + 1) / (steps + 1)
    return np.asarray(left * np.expm1(left) / math.expm1(1.0))


@dataclass(frozen=True)
class ActionStep:
    """One row of a chunk."""

    number: int  # grid time of its target
    row: Array  # the action, (A,)
    seq: int  # of the observation that it answers
    seen: int  # when that observation was taken [ns]


class ChunkQueue:
    """Steps by number; none before `next` is accepted."""

    def __init__(self) -> None:
        self._steps: dict[int, ActionStep] = {}
        self.next = 0
        """The first step that is not executed yet."""
        self._open = 0
        """The first step whose time is not over; at most `next`."""

    def __len__(self) -> int:
        """Number of queued steps."""
        return len(self._steps)

    def flush(self) -> None:
        """Drop all steps."""
        self._steps.clear()

    def late(self, first: int, rows: int) -> int:
        """How many of so many rows from the step ``first`` on come too late."""
        return min(max(self._open - first, 0), rows)

    def splice(self, first: int, rows: Array, seq: int, seen: int, at_rest: bool = False) -> int:
        """Take in rows (K, A) from the step ``first`` on; returns the number of late steps.

        They answer observation ``seq``, which was taken at ``seen`` [ns]. If the arm is at rest, a
        chunk that is late only in part begins with its first row, as soon as it can.
        """
        late = self.late(first, len(rows))
        if at_rest and late < len(rows):
            late, first = 0, max(first, self.next)
        begun = min(max(self.next - first, 0), len(rows))
        if begun == len(rows):
            return late
        begin = first + begun
        self._steps = {n: step for n, step in self._steps.items() if n < begin}
        for number, row in enumerate(rows[begun:], begin):
            if number < self.next + LONGEST:
                self._steps[number] = ActionStep(number, np.array(row, dtype=np.float64), seq, seen)
        return late

    def take(self, number: int, past: int | None = None) -> ActionStep | None:
        """Execute the step of this number and drop those before it.

        The time of the steps up to ``past`` is over; default: of this step itself.
        """
        self.next = max(self.next, number + 1)
        self._open = max(self._open, (number if past is None else past) + 1)
        step = self._steps.get(number)
        self._steps = {n: later for n, later in self._steps.items() if n >= self.next}
        return step

    def peek(self, number: int) -> ActionStep | None:
        """The step of this number, without executing it."""
        return self._steps.get(number)

    def plan(self, steps: int, newest: Array) -> list[Array]:
        """Rows of the next so many steps; where none is queued, the one before it goes on.

        ``newest`` is what was sent last.
        """
        rows: list[Array] = []
        for number in range(self.next, self.next + steps):
            step = self._steps.get(number)
            newest = newest if step is None else step.row
            rows.append(newest)
        return rows

    def ahead(self, longest: int) -> tuple[int, list[Array]]:
        """The first step to come, and the rows from it on without a gap, at most so many."""
        first = min(self._steps, default=self.next)
        rows: list[Array] = []
        while len(rows) < longest and (step := self._steps.get(first + len(rows))) is not None:
            rows.append(step.row)
        return first, rows

    def drop_older(self, seen: int) -> int:
        """Drop steps whose observation was taken before ``seen`` [ns]; returns how many."""
        kept = {n: step for n, step in self._steps.items() if step.seen >= seen}
        dropped = len(self._steps) - len(kept)
        self._steps = kept
        return dropped
