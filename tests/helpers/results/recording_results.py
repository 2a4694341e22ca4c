"""docs/results/recording.md: what kills, cuts and slow disks cost in a whole run."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

_HEAD = """# Recordings that are cut off

Written by `./surg test --full` (`tests/unit/recording/test_*.py`); random times and places, seeded.
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
note = ResultsPage("recording.md", _HEAD, ROWS).note
