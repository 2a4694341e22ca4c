"""docs/results/policy_wire.md: what the tests of the policies' wire count."""

from helpers.results.results_page import ResultsPage

ROWS = (
    "round trips of drawn messages",
    "kinds of wrong messages, each refused for its own reason",
    "fuzzed messages",
)
_HEAD = """# The policies' wire under test

Written by `./surg test --full` (`tests/unit/policy/test_policy_wire.py`). A fuzzed message is a
good one with flipped bits, with frames cut, mixed or repeated, with other fields, descriptions that
lie or numbers that are none, or it is noise; every hundredth is followed by a good one, which
has to be understood.

| what | cases | result |
|---|---|---|
"""

note = ResultsPage("policy_wire.md", _HEAD, ROWS).note
