"""docs/results/sync.md: what the tests of clocks and of the video lag measured in a whole run."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

note = ResultsPage("sync.md", whole=True).note
