"""Pages of which a program writes one part, and a person the rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

Table = Sequence[Sequence[str]]


def write_part(
    page: Path, begin: str, end: str, head: str, tables: Sequence[tuple[str, Table]]
) -> None:
    """Replace the generated part of a page; the reading round it stays.

    Args:
        page: Markdown file; made when it is not there.
        begin: Line before the part.
        end: Line after it.
        head: What it begins with.
        tables: Heading and rows of each table, the first row being its head.
    """
    lines = [begin, "", head]
    for heading, rows in tables:
        lines += ["", f"### {heading}", "", "| " + " | ".join(rows[0]) + " |"]
        lines.append("|" + "---|" * len(rows[0]))
        lines += ["| " + " | ".join(row) + " |" for row in rows[1:]]
    text = "\n".join([*lines, "", end])
    old = page.read_text("utf-8") if page.exists() else f"# Benchmark\n\n{begin}\n{end}\n"
    before, _, rest = old.partition(begin)
    page.write_text(before + text + rest.partition(end)[2], encoding="utf-8")
