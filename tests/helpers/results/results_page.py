"""A page of the docs with tables of figures that several tests find."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

from surg_cli.host import paths

FOLDER = paths.ROOT / "docs" / "results"


class ResultsPage:
    """The figures of a page. What it measures, its columns and its rows stand on the page itself.

    Args:
        name: Of the file.
        whole: Whether only a run that finds every row writes the page; else the rows that it does
            not find stay as they are.
        folder: Where the page lies.
    """

    def __init__(self, name: str, whole: bool = False, folder: Path = FOLDER) -> None:
        self._name, self._whole, self._folder = name, whole, folder
        self._found: dict[str, str] = {}

    def note(self, row: str, cases: int | None, result: str) -> None:
        """Print a figure and keep it; write the page where that is asked for.

        Args:
            row: Of the page.
            cases: How many were measured; None for a page without that column.
            result: What was found; it may fill several cells, with `` | `` between them.

        Raises:
            KeyError: The page has no such row.
        """
        print(f"{row}: {cases}: {result}")
        folder = os.environ.get("SURG_RESULTS_DIR")
        page, stands = Path(folder or self._folder, self._name), self._folder / self._name
        lines = (page if page.exists() else stands).read_text("utf-8").splitlines()
        rows = {
            line.split(" | ")[0].removeprefix("| "): place
            for place, (line, below) in enumerate(itertools.zip_longest(lines, lines[1:]))
            if line.startswith("| ") and not (below or "").startswith("|---")
        }
        if row not in rows:
            raise KeyError(row)
        cells = [row, result] if cases is None else [row, str(cases), result]
        self._found[row] = f"| {' | '.join(cells)} |"
        if folder and (not self._whole or self._found.keys() == rows.keys()):
            for name, found in self._found.items():
                lines[rows[name]] = found
            page.write_text("\n".join(lines) + "\n", "utf-8")
