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
from surg_recording.episode.checked import checked_reading
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.episode.table_file import read_blocks

Rows = npt.NDArray[np.int64]

BLOCK = 16384
"""Rows in memory with all wanted columns."""

_ROW = "row of the file"


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
        checked = checked_reading.cycle_columns(self.joints, self.wristed) if self._is_cycle else ()
        kept: list[Table] = []
        begin = 0
        for block in read_blocks(self.path, wanted={*columns, *checked, "stamp_ns"}, rows=BLOCK):
            inside = slice(max(self._first - begin, 0), max(self._last + 1 - begin, 0))
            if self._is_cycle:
                checked_reading.check_cycle(self.path, block.select(inside))
            low, high = np.searchsorted(places, [begin, begin + len(block)])
            kept.append(block.select(places[low:high] - begin))
            begin += len(block)
        names = ("stamp_ns", *columns)
        return Table(
            self.index.name, {name: np.concatenate([part[name] for part in kept]) for name in names}
        )


def cycles(recorded: Episode, arm: str, segment: Segment | None = None) -> LongTable:
    """The control cycles of an arm; an EpisodeError if the table is not as recorded."""
    columns = ("homed", "command", "accepted", "roll", "roll_goal", "roll_set")
    return _open(recorded, f"cycle_{arm}", segment, columns)


def truth(recorded: Episode, arm: str, segment: Segment | None = None) -> LongTable:
    """The simulator's ground truth of an arm; an EpisodeError if it is not as recorded."""
    return _open(recorded, f"ground_truth_{arm}", segment, ())


def _open(
    recorded: Episode, name: str, segment: Segment | None, columns: tuple[str, ...]
) -> LongTable:
    numbered = None if segment is None else _ROW
    table = checked_reading.checked_table(recorded, name, segment, columns, numbered)
    path = recorded.folder / f"{name}.csv"
    columns_of_file = next(read_blocks(path, rows=1)).columns
    joints = table_columns.joint_count(columns_of_file)
    wristed = checked_reading.WRIST[0] in columns_of_file
    first, last = 0, len(table) - 1
    if numbered is not None:
        first, last = int(table[_ROW][0]), int(table[_ROW][-1])
    index = table.without("receive_ns")
    later = np.append(np.diff(table["stamp_ns"]) > 0, True)
    if not later.all():
        index = index if numbered else index.with_column(_ROW, np.arange(len(table)))
        index = index.select(np.flatnonzero(later))
    return LongTable(path, index, joints, wristed, first, last, name.startswith("cycle_"))
