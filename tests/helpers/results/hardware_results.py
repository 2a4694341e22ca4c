"""docs/results/hardware.md: what the emulated arms did, and how they stop."""

from __future__ import annotations

from collections.abc import Sequence

from helpers.results.results_page import ResultsPage

SPEEDS = (0.012, 0.05, 0.25)
"""Of the tip [m/s]."""
STOPS = (
    *("protective stop", "slider at 50 %", "stall 15 ms", "stall 100 ms"),
    *("controller silent", "node gone"),
)
"""The stops of the page; the tests print the others."""
SURGEON = "chain: synthetic surgeon's motions"
BUNDLED = "chain: bundled motion"
RECORDED = "chain: recorded knot tying"
FUZZ_STATES = "fuzz: states to the driver"
FUZZ_DATAGRAMS = "fuzz: datagrams between driver and node"
FUZZ_DASHBOARD = "fuzz: answers of the dashboard server"
FUZZ_SERVER = "fuzz: packets to the emulated RTDE server"
ROBOTS = ("simulated arm", "emulated UR5e")
FRANKY = "processes, fr3 of franky-sim"
FRANKY_CHAIN = "chain, fr3 with the joints of franky-sim"


def franka(name: str, loss: float, where: str = "chain") -> str:
    """Name of a row of a Franka arm that plays the bundled motion."""
    lost = f", {100 * loss:g} % lost" if loss else ""
    return f"{where}, {name}{lost}"


def demo(cell: str, motion: str) -> str:
    """Name of a row of `./surg demo --robot`."""
    return f"demo: {cell}, {motion} motion"


def spread_row(spread: float) -> str:
    """Name of a row of a robot that stops itself, by the spread of its joints' lags [ms]."""
    return f"chain: protective stop, 50 mm/s, joint lags {spread:.1f} ms apart"


def policy_row(which: str, robot: str) -> str:
    """Name of a row of a policy for bowel grasping and retraction."""
    return f"policy: {which}, {robot}"


def urcl(program: str) -> str:
    """Name of a row of the maker's client library: a program of its tests, or its examples."""
    return f"urcl: {program}"


_PAGE = ResultsPage("hardware.md")
note = _PAGE.note
_stops: dict[str, dict[float, tuple[float | None, float]]] = {}


def note_stop(what: str, speed: float, rest: float | None, off: float) -> None:
    """Print a stop; its row is written once all speeds are there.

    Args:
        what: The fault.
        speed: Of `SPEEDS` [m/s].
        rest: Time to rest [ms]; None where the arm goes on.
        off: Largest deviation [mm].
    """
    print(f"chain: {what}, {1e3 * speed:.0f} mm/s: rest {rest} ms, deviation {off:.3f} mm")
    found = _stops.setdefault(what, {})
    found[speed] = (rest, off)
    if len(found) == len(SPEEDS) and what in STOPS:
        note(f"chain: {what}", len(SPEEDS), stop_words([found[each] for each in SPEEDS]))


def stop_words(stops: Sequence[tuple[float | None, float]]) -> str:
    """Times to rest [ms] and deviations [mm] as the page says them."""
    rests = ", ".join(f"{rest:.0f}" for rest, _ in stops if rest is not None)
    offs = ", ".join(f"{off:.3f}" for _, off in stops)
    return f"{f'rest {rests} ms' if rests else 'goes on'}; {offs} mm"
