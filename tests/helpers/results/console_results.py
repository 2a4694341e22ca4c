"""docs/results/console.md: how soon an arm holds when its operator's tab is gone."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

_HEAD = """# Console: times

Written by `./surg test --full` (`tests/e2e/test_console_page.py`, `test_console_teleop.py`):
headless Chromium, wall clock of the machine that ran it.

| what | rounds | median | largest | measured |
|---|---|---|---|---|
"""
_found: dict[str, str] = {}


def keeps(what: str, seconds: Sequence[float], limit: float) -> None:
    """Fail where a time is above its limit.

    Of twenty rounds one may be: the machine does other things beside. It is printed.

    Args:
        what: Was measured.
        seconds: Times [s].
        limit: None may be above it [s].
    """
    above = sorted(each for each in seconds if each > limit)
    words = f"{what}: {', '.join(f'{1e3 * each:.0f}' for each in above)} ms of {1e3 * limit:.0f} ms"
    if above:
        print(f"{words}, in {len(above)} of {len(seconds)} rounds")
    assert len(above) <= len(seconds) // 20, words


def note(what: str, rounds: int, seconds: Sequence[float], meaning: str) -> None:
    """Print times, keep them, and write the page when it is asked for.

    Args:
        what: Row of the table.
        rounds: How often it was done.
        seconds: Times [s].
        meaning: From what to what.
    """
    ordered = sorted(1e3 * each for each in seconds)
    middle, largest = ordered[len(ordered) // 2], ordered[-1]
    row = f"| {what} | {rounds} | {middle:.0f} ms | {largest:.0f} ms | {meaning} |"
    print(row)
    _found[what] = row
    folder = os.environ.get("SURG_RESULTS_DIR")
    if folder:
        Path(folder, "console.md").write_text(_HEAD + "\n".join(_found.values()) + "\n", "utf-8")
