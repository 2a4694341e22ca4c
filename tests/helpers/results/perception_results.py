"""docs/results/perception.md: what the tests of the endoscope's calibration find."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

SIZES = ((640, 480), (960, 540), (1280, 720))
PAGE = ResultsPage("perception.md")
