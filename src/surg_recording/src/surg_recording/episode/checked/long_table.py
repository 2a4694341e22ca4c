"""Reads a long table in two passes, so that memory does not grow with all of its columns.

The first pass keeps a few columns of every row: those that decide which rows are used. The second
pass keeps all wanted columns of the used rows only, and checks every row that it passes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from pathlib import Path

import numpy as np
import numpy.typing as npt

from surg_recording.clock.clock_segments import Segment
from surg_recording.episode import table_columns
from surg_recording.episode.checked.checked_reading import checked_table
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.episode.table_file import read_blocks

Rows = npt.NDArray[np.int64]

BLOCK = 16384
"""Rows in memory with all wanted columns."""

_ROW = "row of the file"
INDEX = ("homed", "command", "accepted", "roll", "roll_goal", "roll_set")
"""Columns of the cycles that the first pass keeps."""

MEASURED = ("p_tip_x", "p_tip_y", "p_tip_z", "s_x", "s_y", "s_z", "roll", "jaw")
"""Columns of the cycles that always hold a measurement; also ``q0``…, ``qd0``…."""

TROCAR = (*(f"p_rcm_{axis}" for axis in "xyz"), *(f"q_br_{axis}" for axis in "xyzw"))
"""Columns of the cycles that are known once the arm is homed."""

WRIST = ("wrist_pitch", "wrist_yaw", *(f"q_tip_{axis}" for axis in "xyzw"))
"""The same, of an instrument with a wrist."""


@dataclasses.dataclass(frozen=True)
class LongTable:
    """A checked table with strictly increasing stamps."""

    path: Path
    index: Table
    """The columns of the first pass, every row. Of equal stamps the last row counts."""
    joints: int
    """Number of joints in its columns."""
    wristed: bool
    """It has the columns of a wrist."""
    _first: int
    _last: int
    _is_cycle: bool

    def at(self, rows: Rows, columns: Collection[str]) -> Table:
        """Read columns of some rows.

        Args:
            rows: (M,) increasing row numbers of ``index``.
            columns: Their names.

        Returns:
            The table with M rows.

        Raises:
            EpisodeError: A column is missing, or a row of the recording holds an impossible value.
        """
        places = self.index[_ROW][rows] if _ROW in self.index else rows
        checked = cycle_columns(self.joints, self.wristed) if self._is_cycle else ()
        kept: list[Table] = []
        begin = 0
        for block in read_blocks(self.path, wanted={*columns, *checked, "stamp_ns"}, rows=BLOCK):
            inside = slice(max(self._first - begin, 0), max(self._last + 1 - begin, 0))
            if self._is_cycle:
                check_cycle(self.path, block.select(inside))
            low, high = np.searchsorted(places, [begin, begin + len(block)])
            kept.append(block.select(places[low:high] - begin))
            begin += len(block)
        names = ("stamp_ns", *columns)
        return Table(
            self.index.name, {name: np.concatenate([part[name] for part in kept]) for name in names}
        )


def read(recorded: Episode, name: str, segment: Segment | None = None) -> LongTable:
    """Control cycles or ground truth of an arm; an EpisodeError if they are not as recorded."""
    is_cycle, numbered = name.startswith("cycle_"), None if segment is None else _ROW
    columns = INDEX if is_cycle else ()
    table = checked_table(recorded, name, segment, columns, numbered)
    path = recorded.folder / f"{name}.csv"
    columns_of_file = next(read_blocks(path, rows=1)).columns
    joints = table_columns.joint_count(columns_of_file)
    wristed = WRIST[0] in columns_of_file
    first, last = 0, len(table) - 1
    if numbered is not None:
        first, last = int(table[_ROW][0]), int(table[_ROW][-1])
    index = table.without("receive_ns")
    later = np.append(np.diff(table["stamp_ns"]) > 0, True)
    if not later.all():
        index = index if numbered else index.with_column(_ROW, np.arange(len(table)))
        index = index.select(np.flatnonzero(later))
    return LongTable(path, index, joints, wristed, first, last, is_cycle)


def cycle_columns(joints: int, wristed: bool) -> tuple[str, ...]:
    """The columns that ``check_cycle`` needs."""
    wrist = WRIST if wristed else ()
    return (
        *MEASURED,
        *wrist,
        *TROCAR,
        "homed",
        *(f"{p}{i}" for p in ("q", "qd") for i in range(joints)),
    )


def check_cycle(path: Path, cycle: Table) -> None:
    """Raise an EpisodeError unless all measured values of control cycles are possible."""
    joints = table_columns.joint_count(cycle.columns)
    cycle.require_finite(
        path, [*MEASURED, *(f"{p}{i}" for p in ("q", "qd") for i in range(joints))]
    )
    wrist = WRIST if WRIST[0] in cycle else ()
    cycle.select(cycle["homed"] == 1).require_finite(path, (*TROCAR, *wrist))
