"""The account of an import: ``import.json``, and a page for people."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from surg_recording.imports.ledger import Ledger
from surg_recording.reports import html_page

JSON, PAGE = "import.json", "import.html"


@dataclasses.dataclass(frozen=True)
class Account:
    """One recording of another program."""

    source: str
    folder: Path | None
    """The episode; None: refused."""
    reason: str
    """Why it was refused."""
    ledger: Ledger


def write_account(out: Path, accounts: Sequence[Account]) -> Path:
    """Write both files of one import below ``out``; returns the page."""
    entries = [
        {
            "source": account.source,
            "episode": account.folder.name if account.folder else None,
            "refused": account.reason or None,
            **account.ledger.stated(),
        }
        for account in accounts
    ]
    (out / JSON).write_text(json.dumps({"imports": entries}, indent=1) + "\n", "utf-8")
    page = out / PAGE
    sections = [_section(entry) for entry in entries]
    refused = sum(entry["refused"] is not None for entry in entries)
    about = f"{len(entries) - refused} episodes, {refused} refused"
    page.write_text(html_page.document("Import", sections, about), "utf-8")
    return page


def _section(entry: dict[str, Any]) -> str:
    if entry["refused"]:
        return html_page.section(entry["source"], entry["refused"], verdict="bad")
    streams = sorted({*entry["kept"], *entry["dropped"], *entry["converted"]})
    rows = [
        (
            stream,
            entry["kept"].get(stream, ""),
            "; ".join(f"{n} {why}" for why, n in entry["dropped"].get(stream, {}).items()),
            entry["converted"].get(stream, ""),
        )
        for stream in streams
    ]
    table = html_page.table(("Stream", "Kept", "Dropped", "Converted"), rows, right=(1,))
    assumed = html_page.bullets(entry["assumed"])
    title = f"{entry['source']} → {entry['episode']}"
    return html_page.section(title, table, "Assumed:" if entry["assumed"] else "", assumed)
