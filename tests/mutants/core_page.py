"""docs/results/mutants.md: which test notices which mutant. A run reads the last page first."""

from __future__ import annotations

import re
from pathlib import Path

from mutants.core_workshop import Noticed, Trial
from mutants.mutants import MUTANTS, Mutant

ROW = re.compile(r"^\| `(?P<mutant>\w+)` \|.*\| (?P<noticed>[^|]+) \|$", re.M)
EARLIER = " (earlier run)"


def read_rows(page: Path) -> dict[str, str]:
    """What the page says of each mutant; empty without a page."""
    if not page.exists():
        return {}
    return {
        row["mutant"]: row["noticed"].removesuffix(EARLIER)
        for row in ROW.finditer(page.read_text())
    }


def trials_of(rows: dict[str, str]) -> dict[str, Trial]:
    """The trial that noticed each mutant."""
    found = {}
    for mutant, noticed in rows.items():
        program, _, what = noticed.partition(": ")
        found[mutant] = Trial(program, what if "." in what else "")
    return found


def write(page: Path, noticed: dict[str, Noticed]) -> None:
    """Write the page; the rows of mutants that did not run stay, and say so."""
    before = read_rows(page)
    rows = [row for mutant in MUTANTS if (row := _row(mutant, noticed, before))]
    never = [f"`{m.name}`" for m in MUTANTS if m.name not in noticed and m.name not in before]
    lines = [
        "# Mutants of the core, and who notices",
        "",
        "Written by `./surg test --full --tier mutants tests/mutants/test_mutants.py`. Each mutant",
        "is a fault put into a copy of the core on purpose. The test named failed with it, and",
        "passed as soon as the fault was taken out again.",
        "",
        f"{len(MUTANTS)} mutants, {len(noticed)} of them run, all of these noticed.",
        *([f"Never run: {', '.join(never)}."] if never else []),
        "",
        "| mutant | where | what it would do | noticed by |",
        "|---|---|---|---|",
        *rows,
    ]
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text("\n".join(lines) + "\n")


def _row(mutant: Mutant, noticed: dict[str, Noticed], before: dict[str, str]) -> str | None:
    """A line of the table; None for a mutant that has never run."""
    if mutant.name in noticed:
        by = str(noticed[mutant.name])
    elif mutant.name in before:
        by = before[mutant.name] + EARLIER
    else:
        return None
    where = ", ".join(sorted({Path(edit.file).name for edit in mutant.edits}))
    return f"| `{mutant.name}` | {where} | {mutant.why} | {by} |"
