"""docs/results/recording.md: what kills, cuts and slow disks cost in a whole run."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

note = ResultsPage("recording.md", whole=True).note
