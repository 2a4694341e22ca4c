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
    "rows of 2 mm from held_action(), 40 mm/s commanded: past a goal at 10 mm, fastest",
    "the skeleton, 10 mm/s commanded: past its goal, fastest",
    "roll-outs of every expert and policy of the client, called swinging",
    "the skeleton by a score card against `./surg run`",
    "ways in which a policy's program dies",
)
PAGE = ResultsPage("policies.md")


def note(row: int, cases: int, found: str) -> None:
    """A row, by its place."""
    PAGE.note(ROWS[row], cases, found)
