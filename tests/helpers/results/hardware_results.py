"""docs/results/ur_stops.md: how an emulated UR arm stops behind its driver."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

_HEAD = """# Stops of an emulated UR5e

Written by `./surg test --full tests/faults/test_faults_ur_driver.py`: the UR driver and
`./surg emulate ur` as processes in real time, without ROS and without the controller. The shaft of
a 0.3 m tool turns about a pivot at a tip speed of 12, 50 or 250 mm/s; nothing corrects the arm.
Rest counts from the mishap. The way is the tip's. The deviation is what the stop adds, by the arm's
own joints. Robot and mishaps are emulated: a real arm brakes in its own way.

| mishap | runs | result |
|---|---|---|
"""
MISHAPS = (
    "protective stop",
    "emergency stop",
    "stall 100 ms",
    "connections reset",
    "reboot",
    "driver killed",
    "driver frozen",
    "controller silent",
    "node gone",
)
SPEEDS = (0.012, 0.05, 0.25)
"""Of the tip [m/s]."""
AGE = "a command until it is executed"


def row(what: str, speed: float) -> str:
    """Name of a row."""
    return f"{what}, {1e3 * speed:.0f} mm/s"


note = ResultsPage(
    "ur_stops.md", _HEAD, (AGE, *(row(what, speed) for what in MISHAPS for speed in SPEEDS))
).note
