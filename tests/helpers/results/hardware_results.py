"""docs/results/hardware.md: what the emulated arms did, and how they stop."""

from __future__ import annotations

from collections.abc import Sequence

from helpers.results.results_page import ResultsPage

_HEAD = """# Emulated arms

Written by `./surg test --full`, each row by its own last run. **The robot is emulated: a real arm
brakes in its own way.** mm: deviation of the shaft from its pivot, by the emulated joints. Stops:
from 12, 50 and 250 mm/s (chain: 152). *chain*: controller, link and robot in one thread on a
made-up clock, joints that lag by 5 to 8.5 ms. *processes*, *demo*: in real time beside other work;
the stops without a controller, mm being what the stop adds. *policy*: `bgr`, seed 3, in tissue.

Emergency stop, user stop, power off and reboot end as the protective stop, a user's pause nearly
so; a killed or frozen driver or a reset connection as a stall of 100 ms.
"""
SPEEDS = (0.012, 0.05, 0.25)
"""Of the tip [m/s]."""
SPREADS = (0.0, 2.0, 3.5)
"""[ms] Largest less least lag of the emulated joints."""
STOPS = {
    "chain": (
        *("protective stop", "slider at 50 %", "stall 15 ms", "stall 100 ms"),
        *("controller silent", "node gone"),
    ),
    "processes": (
        *("protective stop", "slider at 50 %", "stall 15 ms", "stall 100 ms"),
        *("controller silent", "node gone"),
    ),
}
"""The stops of the page; the tests print the others."""
SURGEON = "chain: synthetic surgeon's motions"
BUNDLED = "chain: bundled motion"
RECORDED = "chain: recorded knot tying"
FUZZ_STATES = "fuzz: states to the driver"
FUZZ_DATAGRAMS = "fuzz: datagrams between driver and node"
FUZZ_DASHBOARD = "fuzz: answers of the dashboard server"
FUZZ_SERVER = "fuzz: packets to the emulated RTDE server"
POLICIES, ROBOTS = ("expert", "learned"), ("simulated arm", "emulated UR5e")
AGE = "a command until it is executed"
FRANKY = "processes, fr3 of franky-sim"
FRANKY_CHAIN = "chain, fr3 with the joints of franky-sim"
FRANKA = (("panda", 0.0), ("panda", 0.002), ("fr3", 0.0))
DEMOS = ("emulated_ur5e", "emulated_panda", "emulated_fr3")
MOTIONS = ("bundled", "recorded")


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


_PAGE = ResultsPage(
    "hardware.md",
    _HEAD,
    (
        *(BUNDLED, SURGEON, RECORDED),
        *(franka(name, loss) for name in ("panda", "fr3") for loss in (0.0, 0.002)),
        *(franka(name, loss, "processes") for name, loss in FRANKA),
        *(FRANKY_CHAIN, FRANKY),
        *(demo(cell, motion) for cell in DEMOS for motion in MOTIONS),
        *(policy_row(which, robot) for which in POLICIES for robot in ROBOTS),
        *(FUZZ_STATES, FUZZ_DATAGRAMS, FUZZ_DASHBOARD, FUZZ_SERVER, AGE),
        *(spread_row(spread) for spread in SPREADS),
        *(f"{where}: {what}" for where, stops in STOPS.items() for what in stops),
    ),
    keep=True,
)
note = _PAGE.note
_stops: dict[tuple[str, str], dict[float, tuple[float | None, float]]] = {}


def note_stop(where: str, what: str, speed: float, rest: float | None, off: float) -> None:
    """Print a stop; its row is written once all speeds are there.

    Args:
        where: Of `STOPS`.
        what: The fault.
        speed: Of `SPEEDS` [m/s].
        rest: Time to rest [ms]; None where the arm goes on.
        off: Largest deviation [mm].
    """
    print(f"{where}: {what}, {1e3 * speed:.0f} mm/s: rest {rest} ms, deviation {off:.3f} mm")
    found = _stops.setdefault((where, what), {})
    found[speed] = (rest, off)
    if len(found) == len(SPEEDS) and what in STOPS[where]:
        note(f"{where}: {what}", len(SPEEDS), stop_words([found[each] for each in SPEEDS]))


def stop_words(stops: Sequence[tuple[float | None, float]]) -> str:
    """Times to rest [ms] and deviations [mm] as the page says them."""
    rests = ", ".join(f"{rest:.0f}" for rest, _ in stops if rest is not None)
    offs = ", ".join(f"{off:.3f}" for _, off in stops)
    return f"{f'rest {rests} ms' if rests else 'goes on'}; {offs} mm"
