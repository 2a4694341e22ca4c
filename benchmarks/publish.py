"""What becomes of a benchmark's figures: shown, kept in a file, put on their page."""

import argparse
import json
from types import ModuleType
from typing import Any

from generated import write_part

from surg_cli.host import paths
from surg_cli.host.terminal import say, table


def publish(result: dict[str, Any], page: ModuleType, options: argparse.Namespace) -> None:
    """Show them; with --json and --page the rest.

    Args:
        result: The figures.
        page: Their page: PAGE, BEGIN and END of its generated part, ``head`` and ``tables``, which
            make the part of the figures.
        options: With ``json`` (a file or None) and ``page`` (whether it is rewritten).
    """
    tables = page.tables(result)
    for heading, rows in tables:
        say(f"\n{heading}\n{table(rows)}")
    if options.json:
        paths.write_text(options.json, json.dumps(result, indent=1) + "\n")
        say(f"\nwritten: {options.json}")
    if options.page:
        write_part(page.PAGE, page.BEGIN, page.END, page.head(result), tables)
        say(f"written: {page.PAGE}")
