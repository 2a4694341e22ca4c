"""The end of the shaft in control cycles: the tip, or the wrist's centre of a wristed instrument.

What a recording says of the shaft (its distance from the pivot, depth, lean, speed) is judged here,
because behind a bent wrist the tip does not lie on the shaft's line.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from surg_core import WristGeometry
from surg_core.transforms import multiply_quaternions
from surg_core.wrist_joints import wrist_centres
from surg_recording.episode import table_columns
from surg_recording.episode.table import Table

GEOMETRY = table_columns.WRIST[0].columns
COLUMNS = (*GEOMETRY, "wrist_yaw", *(f"q_tip_{axis}" for axis in "xyzw"))
"""Columns that ``shaft_ends`` needs of a wristed arm's measured shaft, besides ``q_br_*``."""


def wrist_of(cycle: Table) -> WristGeometry | None:
    """Lengths and turn of the wrist; None: the instrument is straight."""
    if GEOMETRY[0] not in cycle:
        return None
    return WristGeometry(*(float(cycle[name][-1]) for name in GEOMETRY))


def shaft_ends(cycle: Table, of: str = "tip") -> npt.NDArray[np.float64]:
    """(N, 3) end of the shaft [m], base frame; ``of``: ``tip`` (measured), ``set`` or ``goal``."""
    p, wrist = cycle.vector(f"p_{of}"), wrist_of(cycle)
    if wrist is None:
        return p
    q_BTip = multiply_quaternions(cycle.vector("q_br", "xyzw"), cycle.vector(f"q_{of}", "xyzw"))
    return wrist_centres(wrist, p, q_BTip, cycle["wrist_yaw" if of == "tip" else f"wrist_yaw_{of}"])
