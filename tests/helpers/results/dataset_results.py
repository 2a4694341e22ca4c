"""docs/results/datasets.md: what the tests of datasets counted, and what real readers found."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

_HEAD = """# Datasets

Written by `./surg test --full tests/unit/datasets`. *Reader*: the real programs (`--tier oracle`);
late: all pictures stamped a frame late. *30 minutes* (`test_datasets_thirty_minutes.py`): 2 x 640 x
480, 20 frames and 500 cycles per second; a worker may use 300 MiB.
"""
COUNTED = (
    "grid times against exact fractions",
    "resampler against brute force, scipy, geometry",
    "pictures in their place, five formats",
    "the same with all pictures stamped a frame late",
    "broken recordings",
    "recordings with a Dask worker killed on the way",
)
"""Rows whose cases add up."""
PROGRAMS = ("lerobot 0.3.3", "lerobot 0.4.4", "robomimic 0.3.0")
STEPS = ("exported as LeRobot 3.0", "opened by lerobot 0.4.4")
_PAGE = ResultsPage(
    "datasets.md",
    _HEAD,
    (
        *COUNTED,
        *(f"reader {name}{how}" for name in PROGRAMS for how in ("", ", late")),
        "30 minutes: recorded",
        *(f"30 minutes: {step}, `--video {how}`" for how in ("copy", "encode") for step in STEPS),
    ),
    keep=True,
)
_cases: dict[str, int] = {}


def note(row: str, cases: int, result: str) -> None:
    """Print a figure and keep it; cases of a counted row add up."""
    if row in COUNTED:
        cases = _cases[row] = cases + _cases.get(row, 0)
    _PAGE.note(row, cases, result)
