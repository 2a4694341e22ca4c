"""The values of an episode: a table, and the video of a camera."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_recording.episode import table_columns
from surg_recording.recording_errors import EpisodeError

Column = npt.NDArray[Any]

LARGEST = 1e6
"""No measured position, angle, speed or force is larger [SI]."""


class Table:
    """One CSV table as read-only numpy arrays by column name.

    Integer columns (all stamps) are int64, so a nanosecond stamp keeps every digit; text columns
    are object arrays; the rest is float64, an empty field NaN.
    """

    def __init__(self, name: str, arrays: Mapping[str, Column]) -> None:
        self.name = name
        self._arrays = dict(arrays)
        for values in self._arrays.values():
            values.setflags(write=False)

    @property
    def columns(self) -> list[str]:
        """Names in file order."""
        return list(self._arrays)

    def __len__(self) -> int:
        return len(next(iter(self._arrays.values()), ()))

    def __contains__(self, column: str) -> bool:
        return column in self._arrays

    def __getitem__(self, column: str) -> Column:
        try:
            return self._arrays[column]
        except KeyError:
            raise EpisodeError(
                f"table {self.name} has no column {column!r}; it has {', '.join(self._arrays)}"
            ) from None

    def vector(self, prefix: str, axes: str = "xyz") -> npt.NDArray[np.float64]:
        """Columns ``<prefix>_x``, ``_y``, … as (N, len(axes)); without a prefix ``x``, ``y``, …."""
        names = [f"{prefix}_{axis}" if prefix else axis for axis in axes]
        return np.stack([self[name] for name in names], axis=1)

    def joints(self, prefix: str = "q") -> npt.NDArray[np.float64]:
        """Columns ``<prefix>0``, ``<prefix>1``, … as (N, joints)."""
        count = table_columns.joint_count(self.columns)
        columns = [self[f"{prefix}{i}"] for i in range(count)]
        return np.stack(columns, axis=1) if columns else np.zeros((len(self), 0))

    def without(self, name: str) -> Table:
        """The table without a column."""
        return Table(self.name, {n: kept for n, kept in self._arrays.items() if n != name})

    def with_column(self, name: str, values: Column) -> Table:
        """The table with one more column."""
        return Table(self.name, {**self._arrays, name: values})

    def select(self, rows: npt.NDArray[Any] | slice) -> Table:
        """The table with these rows only."""
        return Table(self.name, {name: kept[rows].copy() for name, kept in self._arrays.items()})

    def require_finite(self, path: Path, columns: Sequence[str]) -> None:
        """Refuse a value that cannot have been measured, by an EpisodeError."""
        for column in columns:
            values = self[column]
            bad = np.flatnonzero(~(np.abs(values) <= LARGEST))
            if len(bad):
                value, stamp = values[bad[0]], self["stamp_ns"][bad[0]]
                what = f"{value:g} is too large" if np.isfinite(value) else "not a number"
                raise EpisodeError(f"{path}, column {column}: {what} at stamp_ns {stamp}")


@dataclasses.dataclass(frozen=True)
class Video:
    """One camera of an episode."""

    name: str
    path: Path
    frames: Table
    """The sidecar: frame, stamp_ns, receive_ns, pts, dropped."""
