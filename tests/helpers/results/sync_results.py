"""docs/results/sync.md: what the tests of clocks and of the video lag measured in a whole run."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

_HEAD = """# Synchronisation

Written by `./surg test --full` (`tests/unit/recording/test_video_lag.py`,
`tests/ros/recording/test_clock_sync_node.py`).
Made-up videos: an instrument before breathing tissue, with noise. Two real `ptp4l` in two network
namespaces share one clock: the true offset is 0.
"""
ROWS = (
    "a lag of 200 ms",
    "nothing moves",
    "breathing tissue, the instrument out of view",
    "a real ptp4l pair",
    "a real ptp4l pair with an offset of 5 ms injected",
)
"""All rows, in order."""
note = ResultsPage("sync.md", _HEAD, ROWS).note
