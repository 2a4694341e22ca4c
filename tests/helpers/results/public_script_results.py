"""docs/results/public_scripts.md: other people's scripts on the simulated arms."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

CELLS = ("sim_ur5e", "sim_panda")
_PAGE = ResultsPage("public_scripts.md")
_found: dict[str, dict[str, str]] = {}


def note(script: str, waits: int, result: str, cell: str) -> None:
    """Print what a script did; its row is kept once both robots have been tried.

    Args:
        script: Its name, without ``.py``.
        waits: Calls of ``wait()``.
        result: What was found.
        cell: Of `CELLS`.
    """
    print(f"{script}, {cell}: {waits} waits: {result}")
    found = _found.setdefault(script, {})
    found[cell] = result
    if len(found) == len(CELLS):
        first, second = (found[each] for each in CELLS)
        words, _, pivot = second.rpartition("; ")
        if first.rpartition("; ")[0] == words:
            second = pivot if words else "the same"
        _PAGE.note(script, waits, f"{first} | {second}")
