"""What becomes of a benchmark's figures: shown, kept in a file, put on their page."""

import argparse
import json
from collections.abc import Sequence
from types import ModuleType
from typing import Any

from surg_cli.host import paths
from surg_cli.host.terminal import say, table

Table = Sequence[Sequence[str]]


def publish(result: dict[str, Any], page: ModuleType, options: argparse.Namespace) -> None:
    """Show them; with --json and --page the rest.

    Args:
        result: The figures.
        page: Their page: PAGE (its file), TEXT (title and what is measured), and ``head`` and
            ``tables``, which make the rest of it from the figures.
        options: With ``json`` (a file or None) and ``page`` (whether it is rewritten).
    """
    tables = page.tables(result)
    for heading, rows in tables:
        say(f"\n{heading}\n{table(rows)}")
    if options.json:
        paths.write_text(options.json, json.dumps(result, indent=1) + "\n")
        say(f"\nwritten: {options.json}")
    if options.page:
        page.PAGE.write_text(markdown(page.TEXT, page.head(result), tables), "utf-8")
        say(f"written: {page.PAGE}")


def markdown(text: str, head: str, tables: Sequence[tuple[str, Table]]) -> str:
    """A page; the first row of each table is its head."""
    lines = [text, head]
    for heading, rows in tables:
        lines += ["", f"## {heading}", "", f"| {' | '.join(rows[0])} |"]
        lines.append("|" + "---|" * len(rows[0]))
        lines += [f"| {' | '.join(row)} |" for row in rows[1:]]
    return "\n".join(lines) + "\n"
