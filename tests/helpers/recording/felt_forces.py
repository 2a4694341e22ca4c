"""Forces that a made-up sensor says, and what a data set must then hold of them.

The sensor of each place says a force at every fifth tick. That of the tip does not know for a
while. The force is another one at each tick, so a row that is a sample off is seen.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import numpy.typing as npt

from helpers.recording import recording_synthetic as base
from helpers.recording.recording_synthetic import R_BR, TICK_NS

PLACES = ("tip", "trocar")
SAMPLE_TICKS = 5
SILENT = range(220, 400)
"""Ticks at which the tip's sensor says that it does not know."""

Array = npt.NDArray[np.float64]


def pull_R(place: str, tick: int) -> Array:
    """(3,) force on a place at a tick, in the rcm frame [N]."""
    if place == "tip":
        return np.array([0.001 * tick, -0.5, 0.25 + 0.0005 * tick])
    return np.array([0.1, 0.002 * tick, -0.3])


def wrench(place: str, tick: int) -> SimpleNamespace:
    """A message-like WrenchStamped in the base frame; stamp 0 where the force is not known."""
    known = not (place == "tip" and tick in SILENT)
    force_B = R_BR @ pull_R(place, tick) if known else np.zeros(3)
    header = base.header(tick * TICK_NS if known else 0)
    return SimpleNamespace(header=header, wrench=SimpleNamespace(force=base.xyz(force_B)))


def expected(grid_ns: int) -> list[float]:
    """The eight numbers of a frame: of the newest sample before it, and whether it is known."""
    tick = (grid_ns // TICK_NS - 1) // SAMPLE_TICKS * SAMPLE_TICKS
    row: list[float] = []
    for place in PLACES:
        known = not (place == "tip" and tick in SILENT)
        row += [*pull_R(place, tick), 1.0] if known else [0.0] * 4
    return row
