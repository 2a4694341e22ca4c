"""docs/results/busy_machine.md: a fast hand at the console beside other programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from helpers.results.results_page import ResultsPage

_HEAD = """# A fast hand on a busy machine

Written by `SURG_TEST_FULL=1 ./surg test tests/e2e/test_busy_machine.py`: a page of the console
sends a hand of 0.5 m/s at scale 0.2 with clutches, and presses Enable when the arm is held. Seven
tenths of the time it moves the endoscope, where that is the arm. The simulator's truth is the
judge. The tip's limit is 0.25 m/s along each axis. FAULT(link): simulator or controller was not
served for 0.1 s.

The last rows: `./surg stop` on a quiet machine, while 1,200 half-open requests and 8 flooding
clients attack the console, and beside 8 programs that never rest.

| cell, arm | s, stops | result |
|---|---|---|
"""
_STOPS = ("`./surg stop`, quiet", "`./surg stop`, attack", "`./surg stop`, load")
_PAGE = ResultsPage(
    "busy_machine.md",
    _HEAD,
    ("sim_ur5e, PSM1", "sim_panda, PSM1", "sim_two_arms, ECM", *_STOPS),
    keep=True,
)


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
        f"{len(ms)} stops while a page drives: the arm leaves ENABLED after {middle} ms (median), "
        f"**{ms[-1]} ms** at most",
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
        f"load {load:.0f}: pivot at most **{seen['pivot_mm']:.3f} mm** "
        f"({seen['pivot_enabled_mm']:.3f} mm while ENABLED), "
        f"FAULT(rcm_error) {seen['ended'].get('FAULT(rcm_error)', 0)}; "
        f"{seen['way_m']:.1f} m of the tip, fastest tick {seen['speed']:.2f} m/s; "
        f"{seen['late_cycles']} of {seen['cycles']} cycles late, longest "
        f"{seen['longest_cycle_ms']:.0f} ms; let go by {ended}; Enable pressed {enabled} times",
    )
