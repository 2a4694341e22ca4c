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
        keep: Whether rows of the page that stands stay until they are found anew: for pages whose
            rows no single run finds.
    """

    def __init__(self, name: str, head: str, rows: Sequence[str], keep: bool = False) -> None:
        self._name, self._head, self._rows, self._keep = name, head, tuple(rows), keep
        self._found: dict[str, tuple[int, str]] = {}

    def note(self, row: str, cases: int, result: str) -> None:
        """Print a figure, keep it, and write the page once all are there and it is asked for."""
        if row not in self._rows:
            raise KeyError(row)
        print(f"{row}: {cases}: {result}")
        self._found[row] = (cases, result)
        folder = os.environ.get("SURG_RESULTS_DIR")
        if not folder:
            return
        page = Path(folder, self._name)
        lines = self._standing(page) | {
            each: f"| {each} | {n} | {said} |" for each, (n, said) in self._found.items()
        }
        if self._keep or lines.keys() >= set(self._rows):
            text = "".join(f"{lines[each]}\n" for each in self._rows if each in lines)
            page.write_text(self._head + text, "utf-8")

    def _standing(self, page: Path) -> dict[str, str]:
        """The rows of the page that stands, by name."""
        if not self._keep or not page.exists():
            return {}
        lines = page.read_text("utf-8").splitlines()
        return {line.split(" | ")[0].removeprefix("| "): line for line in lines}
