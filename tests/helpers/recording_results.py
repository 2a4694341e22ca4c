"""docs/results/recording.md: what kills, cuts and slow disks cost in a whole run."""

from __future__ import annotations

import os
from pathlib import Path

_HEAD = """# Recordings that are cut off

Written by `./surg test --full` (`tests/unit/test_recording_*.py`); random times and places, seeded.

| what | cases | result |
|---|---|---|
"""
ROWS = (
    "kill -9 of the recorder: video",
    "kill -9 of the encoder: video",
    "kill -9 of both: video",
    "kill -9 of the recorder: rows",
    "kill -9 of the recorder: whole episode recovered",
    "kill -9 of the encoder, recorder lives, freerun",
    "kill -9 of the encoder, recorder lives, lockstep",
    "video cut at a random byte",
    "two connections, with headers",
    "two connections, without headers",
    "disk of 40 kB/s",
    "disk of 6 MB",
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
        Path(folder, "recording.md").write_text(_HEAD + "".join(lines), "utf-8")
