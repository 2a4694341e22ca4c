"""What a person reads: messages, a progress line, tables, and errors that say what to do."""

from __future__ import annotations

import os
import shutil
import sys
import time
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Any


class CliError(Exception):
    """An error that a person can act on: ends the command with its text and no traceback.

    ``code`` is the command's exit status: 1 for a failed run, 2 for wrong input.
    """

    def __init__(self, text: str, code: int = 1) -> None:
        super().__init__(text)
        self.code = code


def is_interactive() -> bool:
    """Whether standard error is a terminal that can redraw a line."""
    return sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def say(text: str) -> None:
    """Print one line of news at once."""
    print(text, flush=True)


def warn(text: str) -> None:
    """Print one line on standard error at once."""
    print(text, file=sys.stderr, flush=True)


def show_page(address: str) -> bool:
    """Open a page in the person's browser; False: there is no display, or no browser."""
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(display) and webbrowser.open(address)


def say_written(file: Path, dry_run: bool) -> None:
    """Print where a calibration is written now, or that it is not."""
    say("nothing written (--dry-run)" if dry_run else f"written: {file}; restart the system")


def confirm(question: str) -> None:
    """Ask a person, and go on only after the whole word `yes`.

    Raises:
        CliError: Any other answer, or nobody to ask.
    """
    say(f"{question} Type yes:")
    if sys.stdin.readline().strip().lower() != "yes":
        raise CliError("not confirmed: nothing was done")


class Progress:
    """One line that is redrawn on a terminal, and a line every ten seconds elsewhere.

    Used as a context manager; `update` is cheap enough to be called at any rate.
    """

    BAR = 24
    QUIET_PERIOD_S = 10.0
    REDRAW_PERIOD_S = 0.1

    def __init__(self, title: str) -> None:
        self._title = title
        self._started = time.monotonic()
        self._last = -1e9
        self._interactive = is_interactive()

    def __enter__(self) -> Progress:
        """Announce the work where the line cannot be redrawn."""
        if not self._interactive:
            say(f"{self._title} …")
            self._last = time.monotonic()
        return self

    def update(self, fraction: float | None, note: str = "") -> None:
        """Show how far the work is, 0 to 1 (None: unknown), with a few words."""
        now = time.monotonic()
        period = self.REDRAW_PERIOD_S if self._interactive else self.QUIET_PERIOD_S
        if now - self._last < period:
            return
        self._last = now
        percent = "" if fraction is None else f"{100 * min(max(fraction, 0.0), 1.0):3.0f} % "
        if not self._interactive:
            say(f"  {self._title}: {percent}{note}".rstrip())
            return
        done = 0 if fraction is None else round(self.BAR * min(max(fraction, 0.0), 1.0))
        bar = "" if fraction is None else f"[{'#' * done}{'.' * (self.BAR - done)}] "
        line = f"{self._title} {bar}{percent}{note} ({now - self._started:.0f} s)"
        width = shutil.get_terminal_size().columns - 1
        sys.stderr.write("\r\033[K" + line[:width])
        sys.stderr.flush()

    def __exit__(self, kind: object, value: object, trace: object) -> None:
        """Clear the line and, after success, say how long the work took."""
        if self._interactive:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()
        if kind is None:
            say(f"{self._title}: done in {time.monotonic() - self._started:.0f} s")


def table(rows: Sequence[Sequence[str]], indent: str = "  ") -> str:
    """Lay out rows of equal length in columns, left-justified; empty for no rows."""
    if not rows:
        return ""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join(
        indent + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def report_findings(findings: Sequence[Any]) -> int:
    """Print findings, with ``good``, ``what``, ``text`` and ``cure``; returns the exit status."""
    for finding in findings:
        sign = {True: "ok  ", False: "BAD ", None: "    "}[finding.good]
        say(f"{sign} {finding.what}: {finding.text}")
        if finding.cure:
            say(f"       to do: {finding.cure}")
    return 1 if any(finding.good is False for finding in findings) else 0
