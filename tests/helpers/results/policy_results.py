"""docs/results/policies.md: what the tests of policies find."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

ROWS = (
    "steps against an oracle of the rules",
    "actions of scripted experts, refused or clipped",
    "chunks against a slow book of the queue",
    "bad frames, with a good one behind every hundredth",
    "passing the end of a 60 mm motion: steps at 20 Hz; the way between them",
    "flood of the port",
    "operator, policy, operator: largest step of the set-point in a cycle",
    "roll-out through the graph against an environment in one process",
    "wire: round trips of drawn messages",
    "wire: kinds of wrong messages, each refused for its own reason",
    "wire: fuzzed messages",
)
PAGE = ResultsPage("policies.md")


def note(row: int, cases: int, found: str) -> None:
    """A row, by its place."""
    PAGE.note(ROWS[row], cases, found)
