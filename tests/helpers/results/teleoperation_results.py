"""docs/results/teleoperation.md: hand, picture and tip; random operators; a bad cable."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

STORMS = "storms of 14 random events"
PULLED, MENDED = "cable pulled", "cable mended after 1 s"
note = ResultsPage("teleoperation.md").note
