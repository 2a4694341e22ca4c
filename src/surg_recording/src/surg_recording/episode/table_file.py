"""Reads the CSV file of a table, whole or in blocks; memory holds only the columns kept."""

from __future__ import annotations

import array
import csv
import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from surg_recording.episode import table_columns
from surg_recording.episode.table import Column, Table
from surg_recording.file_io import regular_file
from surg_recording.recording_errors import EpisodeError


def read_table(
    path: Path, kinds: Mapping[str, str] | None = None, wanted: Collection[str] | None = None
) -> Table:
    """Read one CSV table line by line; memory holds only the columns kept.

    Args:
        path: The file.
        kinds: Column → ``int``, ``float`` or ``text``; None: by the names in ``table_columns``.
            With them, a column of integers with an empty field becomes floats.
        wanted: Columns to keep, if the file has them; None for all.

    Raises:
        EpisodeError: Missing or empty file, a wrong number of fields, or a wrong value; states
            file, line, column and value.
    """
    (table,) = read_blocks(path, kinds, wanted)
    return table


def read_blocks(
    path: Path,
    kinds: Mapping[str, str] | None = None,
    wanted: Collection[str] | None = None,
    rows: int | None = None,
) -> Iterator[Table]:
    """Read one CSV table in blocks of at most ``rows`` rows; None: in one block.

    Arguments and errors as for ``read_table``. A file without rows gives one empty block.
    """
    regular_file(path)
    try:
        with open(path, newline="", encoding="utf-8") as file:
            lines = csv.reader(file)
            header: list[str] = next(lines, [])
            if not header:
                raise EpisodeError(f"{path}: empty, not even a header line")
            if len(set(header)) != len(header):
                raise EpisodeError(f"{path}, line 1: a column name occurs twice")
            numbered = enumerate(lines, start=2)
            first = True
            while True:
                kept = [
                    (place, _Column(path, name, kinds))
                    for place, name in enumerate(header)
                    if wanted is None or name in wanted
                ]
                filled = 0
                for number, line in itertools.islice(numbered, rows):
                    if len(line) != len(header):
                        raise EpisodeError(
                            f"{path}, line {number}: {len(line)} fields, the header has"
                            f" {len(header)}"
                        )
                    for place, column in kept:
                        column.append(line[place], number)
                    filled += 1
                if filled or first:
                    yield Table(path.stem, {column.name: column.array() for _, column in kept})
                first = False
                if rows is None or filled < rows:
                    return
    except OSError as problem:
        raise EpisodeError(f"{path}: cannot be read ({problem.strerror})") from None
    except (csv.Error, UnicodeDecodeError) as problem:
        raise EpisodeError(f"{path}: not a CSV file ({problem})") from problem


def concatenated(blocks: Iterable[Table]) -> Table:
    """One table of blocks with the same columns; small integers take a byte each."""
    parts: dict[str, list[Column]] = {}
    name = ""
    for block in blocks:
        name = block.name
        for column in block.columns:
            values = block[column] if column.endswith("_ns") else _small(block[column])
            parts.setdefault(column, []).append(values)
    whole: dict[str, Column] = {}
    for column in list(parts):
        whole[column] = np.concatenate(parts.pop(column))
    return Table(name, whole)


def _small(values: Column) -> Column:
    if values.dtype == np.int64 and len(values) and values.min() >= 0 and values.max() < 128:
        return values.astype(np.int8)
    return values


_KINDS = {"int": int, "float": float, "text": str}
_CODE = {int: "q", float: "d"}


class _Column:
    """The values of one column while a file is read."""

    def __init__(self, path: Path, name: str, kinds: Mapping[str, str] | None) -> None:
        self.name, self._path = name, path
        self._kind: type = table_columns.kind(name)
        if kinds is not None:
            self._kind = _KINDS.get(kinds.get(name, ""), float)
        self._holey = kinds is not None
        self._values: Any = [] if self._kind is str else array.array(_CODE[self._kind])

    def append(self, text: str, line: int) -> None:
        """Add one field."""
        if not text and self._kind is int and self._holey:
            self._kind, self._values = float, array.array("d", self._values)
        try:
            self._values.append(self._kind(text if text or self._kind is not float else "nan"))
        except (ValueError, OverflowError):
            raise EpisodeError(
                f"{self._path}, line {line}, column {self.name}: {text!r} is not"
                f" {'a 64-bit integer' if self._kind is int else 'a number'}"
            ) from None

    def array(self) -> Column:
        """The fields as a numpy array."""
        if self._kind is str:
            texts = np.empty(len(self._values), dtype=object)
            texts[:] = self._values
            return texts
        dtype = np.int64 if self._kind is int else np.float64
        return np.frombuffer(self._values, dtype) if len(self._values) else np.empty(0, dtype)
