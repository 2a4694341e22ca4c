"""A page of docs/results: figures that several test files find, written once all are there."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path


class ResultsPage:
    """A table of figures with a fixed list of rows.

    Args:
        name: Of the file in docs/results.
        head: What stands above the table's rows, with the table's own head.
        rows: All rows, in order.
    """

    def __init__(self, name: str, head: str, rows: Sequence[str]) -> None:
        self._name, self._head, self._rows = name, head, tuple(rows)
        self._found: dict[str, tuple[int, str]] = {}

    def note(self, row: str, cases: int, result: str) -> None:
        """Print a figure, keep it, and write the page once all are there and it is asked for."""
        if row not in self._rows:
            raise KeyError(row)
        print(f"{row}: {cases}: {result}")
        self._found[row] = (cases, result)
        folder = os.environ.get("SURG_RESULTS_DIR")
        if folder and len(self._found) == len(self._rows):
            lines = [f"| {each} | {n} | {said} |\n" for each, (n, said) in self._sorted()]
            Path(folder, self._name).write_text(self._head + "".join(lines), "utf-8")

    def _sorted(self) -> list[tuple[str, tuple[int, str]]]:
        return [(row, self._found[row]) for row in self._rows]
