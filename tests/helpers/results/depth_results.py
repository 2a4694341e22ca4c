"""docs/results/depth.md: what the tests of depth and marks find."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

METHODS = ("sgbm", "sgbm_8")
CRFS = (12, 18, 23, 28)
PAGE = ResultsPage("depth.md")
