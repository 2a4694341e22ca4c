"""docs/results/busy_machine.md: a fast hand at the console beside other programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from helpers.results.results_page import ResultsPage

_PAGE = ResultsPage("busy_machine.md")


def note_stops(around: str, took: Sequence[float]) -> None:
    """Print and keep how fast `./surg stop` pauses.

    Args:
        around: What there is beside the system: one of quiet, attack, load.
        took: Times from the command to the first cycle that says so [s].
    """
    ms = sorted(round(1e3 * t) for t in took)
    middle = ms[len(ms) // 2]
    _PAGE.note(
        f"`./surg stop`, {around}",
        len(ms),
        f"leaves ENABLED after {middle} ms (median), **{ms[-1]} ms** at most",
    )


def note(cell: str, seconds: float, load: float, enabled: int, seen: dict[str, Any]) -> None:
    """Print and keep what the judge has seen.

    Args:
        cell: The cell and its arm.
        seconds: Of the storm [s].
        load: Mean number of programs that want a processor.
        enabled: How often the operator pressed Enable.
        seen: Counts of ``pivot_judge.py``.
    """
    ended = ", ".join(f"{how} {count}" for how, count in sorted(seen["ended"].items())) or "never"
    _PAGE.note(
        cell,
        round(seconds),
        f"load {load:.0f}: pivot at most **{seen['pivot_mm']:.3f} mm**, tip {seen['way_m']:.1f} m, "
        f"at most {seen['speed']:.2f} m/s; {seen['late_cycles']} of {seen['cycles']} cycles late, "
        f"longest {seen['longest_cycle_ms']:.0f} ms; let go by {ended}",
    )
