"""docs/results/corruptions.md: what every command makes of every corrupted recording."""

from __future__ import annotations

from helpers.recording.corruptions import ALL
from helpers.results.results_page import ResultsPage

LONGEST = "longest of all"
_HEAD = """# Corrupted recordings

Written by `./surg test --full tests/unit/recording/test_recording_corruptions.py`. A recording of
one arm, a camera and a task is broken in one way per row. Beside it lies an intact one, which every
command uses. *right*: the result of the intact recording. *error*: it is left out, or the page says
by name what is wrong. *recovered*: readable, and marked as incomplete. No cell is a trace, a hang
above 10 s or a loss of data: all bytes are there afterwards, in their place or in `*.damaged`.

| what is broken | commands | result |
|---|---|---|
"""
note = ResultsPage("corruptions.md", _HEAD, [*(each.name for each in ALL), LONGEST]).note
