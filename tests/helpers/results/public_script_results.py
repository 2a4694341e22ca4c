"""docs/results/public_scripts.md: other people's scripts on the simulated arms."""

from __future__ import annotations

from collections.abc import Sequence

from helpers.results.results_page import ResultsPage

CELLS = ("sim_ur5e", "sim_panda")
WRIST = "sim_ur5e_wrist"
"""Six joints: the scripts that move joints go to more of them."""
ROS2 = "ROS 2"
"""The scripts with rclpy, on the first cell."""
PLACES = (*CELLS, WRIST, ROS2)
_PAGE = ResultsPage("public_scripts.md")
_found: dict[str, dict[str, str]] = {}


def note(script: str, waits: int, result: str, place: str, places: Sequence[str] = PLACES) -> None:
    """Print what a script did; its row is kept once all places have been tried.

    Args:
        script: Its name, without ``.py``.
        waits: Calls of ``wait()``.
        result: What was found.
        place: Of `PLACES`.
        places: Where it is tried; the page's other columns say nothing.
    """
    print(f"{script}, {place}: {waits} waits: {result}")
    found = _found.setdefault(script, {})
    found[place] = result
    if len(found) == len(places):
        _PAGE.note(script, None, row([found.get(each, "–") for each in PLACES]))


def row(results: Sequence[str]) -> str:
    """The cells of a row; what the first one says is not said again."""
    first, cells = results[0].partition("; pivot")[0], [results[0]]
    for result in results[1:]:
        if result == results[0]:
            cells.append("=")
        else:
            cells.append(result.removeprefix(f"{first}; pivot "))
    return " | ".join(cells)
