"""Rows of the first table of docs/results/phantom.md, put into the page that is there.

The page says by which command each row was measured that another run has put in.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

FIRST = "## Success of the scripted senders, test seeds"
"""Heading of the table."""
NONE = "None."
"""Stands where failures would."""
_ROWS, _BY = "- Rows of ", ": by `"


def check(page: Path) -> None:
    """Raise ValueError, naming the file, if this is no page with the table."""
    if not page.is_file() or FIRST not in page.read_text(encoding="utf-8").splitlines():
        raise ValueError(f"{page}: is no page with the heading {FIRST!r}; write one with --out")


def _label(row: str) -> str:
    return row.split("|")[1].strip()


def _task(label: str) -> str:
    return label.partition(", ")[0]


def _said(old: Sequence[str], labels: Iterable[str], command: str) -> list[str]:
    """The lines that name commands: with the new one, and without what it has measured anew."""
    new = [label.replace(", ", " with ") for label in labels]
    lines = []
    for line in old:
        names, _, by = line.removeprefix(_ROWS).partition(_BY)
        left = [name for name in names.split(", ") if name not in new]
        if left:
            lines.append(f"{_ROWS}{', '.join(left)}{_BY}{by}")
    return [*lines, f"{_ROWS}{', '.join(new)}{_BY}{command}`"]


def put(page: str, rows: Mapping[str, str], failed: Sequence[str], command: str) -> str:
    """A page with these rows in its first table instead of those of the same label.

    Args:
        page: Its Markdown, as ``expert_evaluation.report`` writes it.
        rows: Lines of the table by their label (task, robot).
        failed: Lines of failures of these rows, or ``NONE`` alone.
        command: That measured them.
    """
    head, _, rest = page.partition(f"\n{FIRST}\n")
    table, _, rest = rest.partition("\nFailures:\n\n")
    causes, gap, second = rest.partition("\n\n")
    columns, line, *kept = table.strip("\n").splitlines()
    both = {_label(row): row for row in kept} | dict(rows)
    old = [
        cause
        for cause in causes.splitlines()
        if cause != NONE and not any(cause.startswith(f"- {label}, ") for label in rows)
    ]
    heads = head.splitlines()
    said = [each for each in heads if _BY in each]
    lines = [
        *"\n".join(each for each in heads if _BY not in each).rstrip("\n").splitlines(),
        "",
        *_said(said, rows, command),
        f"\n{FIRST}\n",
        columns,
        line,
        *(both[label] for label in sorted(both, key=_task)),
        "\nFailures:\n",
        *([*old, *(cause for cause in failed if cause != NONE)] or [NONE]),
    ]
    return "\n".join(lines) + (gap + second if gap else "\n")
