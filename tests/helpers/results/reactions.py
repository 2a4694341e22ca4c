"""The table of reaction times: every fault that is injected says how soon the arm reacted."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

HEAD = """\
# Faults and measured reactions

Written by `./surg test --full tests/faults`. Simulation, seeded. Cycles of 2 ms count from the
sample that carries the fault; 0 is the cycle that reads it. Times in ms are of real processes
beside other work. [Ids](../reference/safety.md); kinds: faults injected, which the run prints.

| id | kinds | reaction: largest / limit, once where equal | n |
|---|---|---|---|
"""
ROWS = (
    *("F01", "F02", "F03", "F10", "F11", "F20", "F21", "F22", "F23", "F24", "F25", "F26"),
    *("F27", "F28", "F31", "F33", "F04", "F05", "F08"),
)
"""Without one of these the page is not written."""


def _of(largest: float, limit: str) -> str:
    """The largest value and its limit; once where they are the same."""
    value, _, unit = limit.partition(" ")
    return f"{value} {unit}".strip() if f"{largest:.4g}" == value else f"{largest:.3g} / {limit}"


@dataclass
class Reactions:
    """Collects reactions; the page is written when all are there."""

    kinds: dict[str, set[str]] = field(default_factory=dict)
    found: dict[tuple[str, str, str], list[float]] = field(default_factory=dict)

    def add(
        self,
        row: str,
        fault: str,
        reaction: str,
        values: Sequence[float],
        limit: float,
        unit: str = "cycles",
    ) -> None:
        """One reaction; fails where the limit is not kept.

        Args:
            row: Its id, such as F01.
            fault: What was injected.
            reaction: What the figures are of.
            values: One per run.
            limit: None may be above it.
            unit: Of values and limit.
        """
        assert values, f"{row}: nothing was measured"
        said = f"{row} {fault}, {reaction}: {max(values):.4g} of {limit:.4g} {unit}"
        print(f"{said}, n {len(values)}")
        self.kinds.setdefault(row, set()).add(fault)
        limited = f"{limit:.4g} {unit}".removesuffix(" 1")
        self.found.setdefault((row, reaction, limited), []).extend(values)
        assert all(value <= limit for value in values), said

    def lines(self) -> list[str]:
        """The rows in Markdown, by id."""
        lines = []
        for row in sorted(self.kinds):
            own = {key[1:]: values for key, values in self.found.items() if key[0] == row}
            said = [f"{what}: {_of(max(v), limit)}" for (what, limit), v in own.items()]
            n = sum(map(len, own.values()))
            lines.append(f"| {row} | {len(self.kinds[row])} | {'; '.join(said)} | {n} |")
        return lines

    def write(self) -> None:
        """Write docs/results/faults.md, of a whole run only."""
        folder = os.environ.get("SURG_RESULTS_DIR")
        if folder and self.kinds.keys() >= set(ROWS):
            Path(folder, "faults.md").write_text(HEAD + "\n".join(self.lines()) + "\n", "utf-8")
