"""docs/results/sync.md: what the tests of clocks and of the video lag measured in a whole run."""

from __future__ import annotations

import os
from pathlib import Path

_HEAD = """# Synchronisation

Written by `./surg test --full` (`tests/unit/test_video_lag.py`,
`tests/ros/test_clock_sync_node.py`).
The videos are made up: an instrument before breathing tissue, in light that varies, with noise; the
clocks are two real `ptp4l` in two network namespaces, which share one clock: the true offset is 0.

| what | cases | result |
|---|---|---|
"""
ROWS = (
    "a lag of 200 ms",
    "nothing moves",
    "breathing tissue, the instrument out of view",
    "a real ptp4l pair",
    "a real ptp4l pair with an offset of 5 ms injected",
)
"""All rows, in order."""
_found: dict[str, tuple[int, str]] = {}


def note(row: str, cases: int, result: str) -> None:
    """Print a figure, keep it, and write the page once all are there and it is asked for."""
    if row not in ROWS:
        raise KeyError(row)
    print(f"{row}: {cases}: {result}")
    _found[row] = (cases, result)
    folder = os.environ.get("SURG_RESULTS_DIR")
    if folder and len(_found) == len(ROWS):
        lines = [f"| {row} | {_found[row][0]} | {_found[row][1]} |\n" for row in ROWS]
        Path(folder, "sync.md").write_text(_HEAD + "".join(lines), "utf-8")
