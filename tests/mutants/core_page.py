"""Which test notices which mutant: a file that the next run reads, and docs/results/mutants.md."""

from __future__ import annotations

import csv
import datetime
from pathlib import Path

from mutants.core_workshop import Noticed, Trial
from mutants.mutants import MUTANTS

KNOWN = Path(__file__).with_name("noticed.csv")
"""Mutant, program, test, date of the run."""


def read(file: Path = KNOWN) -> dict[str, list[str]]:
    """Program, test and date by mutant; empty without a file."""
    if not file.exists():
        return {}
    with file.open(encoding="utf-8", newline="") as stream:
        return {name: rest for name, *rest in csv.reader(stream)}


def trials_of(rows: dict[str, list[str]]) -> dict[str, Trial]:
    """The trial that noticed each mutant; the fuzz names an oracle, which is no test."""
    return {
        name: Trial(program, test if "." in test else "")
        for name, (program, test, _) in rows.items()
    }


def write(page: Path, noticed: dict[str, Noticed], file: Path = KNOWN) -> None:
    """Keep who noticed what, and write the page; mutants that did not run keep their date."""
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    rows = read(file) | {name: [by.trial.program, by.what, today] for name, by in noticed.items()}
    rows = {mutant.name: rows[mutant.name] for mutant in MUTANTS if mutant.name in rows}
    with file.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows(
            [name, *row] for name, row in rows.items()
        )
    page.write_text(text(rows), "utf-8")


def text(rows: dict[str, list[str]]) -> str:
    """The page in Markdown."""
    never = [f"`{mutant.name}`" for mutant in MUTANTS if mutant.name not in rows]
    folders: dict[str, list[str]] = {}
    for mutant in MUTANTS:
        if mutant.name in rows:
            folder = Path(mutant.edits[0].file).parent.name
            folders.setdefault(folder, []).append(rows[mutant.name][0])
    dates = sorted(date for _, _, date in rows.values())
    lines = [
        "# Mutants of the core, and who notices",
        "",
        "Written by `./surg test --full --tier mutants tests/mutants/test_mutants.py`. A mutant is",
        "a fault put into a copy of the core on purpose (`tests/mutants/mutants.py`). The test in",
        "`tests/mutants/noticed.csv` failed with it and passed without it.",
        "",
        f"{len(rows)} of {len(MUTANTS)} mutants noticed, from {dates[0]} to {dates[-1]}.",
        *([f"Never run: {', '.join(never)}."] if never else []),
        "",
        "| mutants of | n | test programs that noticed |",
        "|---|---|---|",
        *(f"| {folder} | {len(by)} | {len(set(by))} |" for folder, by in sorted(folders.items())),
    ]
    return "\n".join(lines) + "\n"
