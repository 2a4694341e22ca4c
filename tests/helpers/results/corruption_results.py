"""docs/results/corruptions.md: what every command makes of every corrupted recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from helpers.results.results_page import ResultsPage

COMMANDS = ("view", "evaluate", "export", "recover")
LONGEST = "longest of all"
_PAGE = ResultsPage("corruptions.md", whole=True)


def note(found: Mapping[str, Mapping[str, str]], longest: float) -> None:
    """Print and keep what commands have made of corruptions.

    Args:
        found: By name of the corruption, the outcome of each command.
        longest: Time of a command [s].
    """
    parts: dict[str, dict[str, Counter[str]]] = {}
    for name, outcomes in found.items():
        print(f"{name}: {', '.join(f'{command}: {how}' for command, how in outcomes.items())}")
        part = parts.setdefault(name.split(":")[0], {each: Counter() for each in COMMANDS})
        for command, how in outcomes.items():
            part[command][how] += 1
    for name, counts in parts.items():
        cells = [", ".join(f"{n} {how}" for how, n in counts[each].items()) for each in COMMANDS]
        _PAGE.note(name, counts[COMMANDS[0]].total(), " | ".join(cells))
    _PAGE.note(LONGEST, len(found) * len(COMMANDS), f"{longest:.1f} s | | |")
