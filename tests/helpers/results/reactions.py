"""The table of reaction times: every fault that is injected says how soon the arm reacted."""

from __future__ import annotations

import os
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

HEAD = """\
# Faults and measured reactions

Written by `./surg test --full tests/faults`. Simulation. Cycles of 2 ms count from the sample that
carries the fault; 0 is the cycle that reads it, exact and the same in every run, and the test fails
on any other. Seeded runs; "the node", signals and ms are real processes by the simulator's or this
machine's clock, which did other things beside. No run may be above the limit. n counts values:
one per run, one per cycle, or 1 for the largest of all runs.

| id | fault | reaction | median | max | limit | unit | n |
|---|---|---|---|---|---|---|---|
"""
ROWS = (
    *("F01", "F02", "F03", "F10", "F11", "F20", "F21", "F22", "F23", "F24", "F25", "F26"),
    *("F27", "F28", "F31", "F33", "F04", "F05", "F08"),
)
"""Without one of these the page is not written."""


@dataclass
class Reactions:
    """Collects rows; the page is written when all are there."""

    rows: list[tuple[str, str]] = field(default_factory=list)

    def add(
        self,
        row: str,
        fault: str,
        reaction: str,
        values: Sequence[float],
        limit: float,
        unit: str = "cycles",
    ) -> None:
        """One line of the table; fails where the limit is not kept.

        Args:
            row: Its id, such as F01.
            fault: What was injected.
            reaction: What the figures are of.
            values: One per run.
            limit: None may be above it.
            unit: Of values and limit.
        """
        assert values, f"{row}: nothing was measured"
        middle, worst = statistics.median(values), max(values)
        cells = [row, fault, reaction, *(f"{x:.4g}" for x in (middle, worst, limit))]
        line = f"| {' | '.join(cells)} | {unit} | {len(values)} |"
        print(line)
        self.rows.append((row, line))
        assert all(value <= limit for value in values), line

    def write(self) -> None:
        """Write docs/results/faults.md, of a whole run only."""
        folder = os.environ.get("SURG_RESULTS_DIR")
        if not folder or not {row for row, _ in self.rows} >= set(ROWS):
            return
        lines = [line for _, line in sorted(self.rows, key=lambda item: item[0])]
        Path(folder, "faults.md").write_text(HEAD + "\n".join(lines) + "\n", "utf-8")
