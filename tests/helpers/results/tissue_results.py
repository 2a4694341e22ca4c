"""docs/results/tissue.md: what the tests of bowel, grasp and assistant measured in a whole run."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

note = ResultsPage("tissue.md", whole=True).note
