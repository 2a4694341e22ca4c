"""docs/results/console.md: how soon an arm holds when its tab is gone, and targets touched."""

from __future__ import annotations

from collections.abc import Sequence

from helpers.results.results_page import ResultsPage

BY_GAMEPAD, BY_FINGERS = "target touched by gamepad", "target touched by fingers"
PAGE = ResultsPage("console.md")


def keeps(what: str, seconds: Sequence[float], limit: float) -> None:
    """Fail where a time is above its limit.

    Of twenty rounds one may be: the machine does other things beside. It is printed.

    Args:
        what: Was measured.
        seconds: Times [s].
        limit: None may be above it [s].
    """
    above = sorted(each for each in seconds if each > limit)
    words = f"{what}: {', '.join(f'{1e3 * each:.0f}' for each in above)} ms of {1e3 * limit:.0f} ms"
    if above:
        print(f"{words}, in {len(above)} of {len(seconds)} rounds")
    assert len(above) <= len(seconds) // 20, words


def note(what: str, rounds: int, seconds: Sequence[float]) -> None:
    """Print times and keep them.

    Args:
        what: Row of the table.
        rounds: How often it was done.
        seconds: Times [s].
    """
    ordered = sorted(1e3 * each for each in seconds)
    middle, largest = ordered[len(ordered) // 2], ordered[-1]
    PAGE.note(what, rounds, f"{middle:.0f} | {largest:.0f}")
