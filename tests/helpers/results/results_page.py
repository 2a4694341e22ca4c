"""A page of docs/results: one table of figures that several tests find."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path


class ResultsPage:
    """A table with a fixed list of rows.

    Args:
        name: Of the file in docs/results.
        head: Title, what is measured, by which command.
        rows: All rows, in order.
        keep: Whether rows of the page that stands stay until they are found anew: for pages whose
            rows no single run finds.
        columns: Headings; a result may fill several cells, with `` | `` between them.
    """

    def __init__(
        self,
        name: str,
        head: str,
        rows: Sequence[str],
        keep: bool = False,
        columns: Sequence[str] = ("what", "n", "result"),
    ) -> None:
        self.name, self.rows, self._keep = name, tuple(rows), keep
        self.head = f"{head}\n| {' | '.join(columns)} |\n{'|---' * len(columns)}|\n"
        self._found: dict[str, str] = {}

    def note(self, row: str, cases: int | None, result: str) -> None:
        """Print a figure and keep it; write the page once all are there and it is asked for.

        Args:
            row: Of the fixed list.
            cases: How many were measured; None for a page without that column.
            result: What was found.
        """
        if row not in self.rows:
            raise KeyError(row)
        print(f"{row}: {cases}: {result}")
        cells = [row, result] if cases is None else [row, str(cases), result]
        self._found[row] = f"| {' | '.join(cells)} |\n"
        folder = os.environ.get("SURG_RESULTS_DIR")
        if not folder:
            return
        page = Path(folder, self.name)
        lines = self._standing(page) | self._found
        if self._keep or lines.keys() >= set(self.rows):
            text = "".join(lines[each] for each in self.rows if each in lines)
            page.write_text(self.head + text, "utf-8")

    def _standing(self, page: Path) -> dict[str, str]:
        """The rows of the page that stands, by name."""
        if not self._keep or not page.exists():
            return {}
        lines = page.read_text("utf-8").splitlines(keepends=True)
        return {line.split(" | ")[0].removeprefix("| "): line for line in lines}
