"""docs/results/datasets.md: what the tests of datasets counted, and what real readers found."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

COUNTED = (
    "grid times against exact fractions",
    "resampler against brute force, scipy, geometry",
    "pictures in their place, five formats",
    "the same, a frame late",
    "broken recordings",
    "recordings with a Dask worker killed on the way",
)
"""Rows whose cases add up."""
_PAGE = ResultsPage("datasets.md")
_cases: dict[str, int] = {}


def note(row: str, cases: int, result: str) -> None:
    """Print a figure and keep it; cases of a counted row add up."""
    if row in COUNTED:
        cases = _cases[row] = cases + _cases.get(row, 0)
    _PAGE.note(row, cases, result)
