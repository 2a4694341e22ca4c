"""Crash-safe CSV files, written by one thread for all tables of an episode.

Callbacks only append a row to a queue. The thread wakes every 10 ms and hands what has arrived to
the kernel with one ``write`` per table: a ``kill -9`` loses the last few milliseconds and truncates
at most one line. Floats are written by ``repr``, the shortest text that reads back to the same
bits.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from surg_recording.file_io import write_all

Row = Sequence[Any]

WAKE_S = 0.01
"""Period in which the thread looks for new rows [s]."""

BATCH = 64
"""Rows formatted between two writes of one table: bounds what a kill can lose in a backlog."""


def _text(value: str) -> str:
    """A string as one CSV field on one line."""
    if not value:
        return ""
    value = value.replace("\r", " ").replace("\n", " ").replace("\0", " ")
    if '"' in value or "," in value:
        return '"' + value.replace('"', '""') + '"'
    return value


def format_row(row: Row) -> str:
    """One line of CSV without its newline; ``None`` is an empty field, a bool 0 or 1."""
    return ",".join([_FIELD.get(type(value), _other)(value) for value in row])


def _other(value: Any) -> str:
    """A field of a type that is rare in a row."""
    if isinstance(value, float):  # numpy.float64
        return float.__repr__(value)
    if isinstance(value, str):
        return _text(str(value))
    return str(int(value))  # bool and numpy integers


_FIELD: dict[type, Callable[[Any], str]] = {
    float: float.__repr__,
    int: int.__repr__,
    str: _text,
    type(None): lambda _: "",
}


class CsvTable:
    """One table: its file, queue and counters. Created by ``CsvWriter.table``."""

    def __init__(self, path: Path, columns: Sequence[str], queue_limit: int | None) -> None:
        self.path = path
        self.columns = list(columns)
        self.queue_limit = queue_limit
        self.taken = 0
        """Rows accepted by ``put``."""
        self.rows = 0
        """Rows handed to the kernel."""
        self.dropped = 0
        """Rows refused because the queue was full or the file had failed."""
        self.last: Row | None = None
        self._queue: deque[Row] = deque()
        self._numbers = itertools.count(1)  # several threads may take the next one
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
        self._fd = os.open(path, flags, 0o644)
        try:
            write_all(self._fd, (",".join(columns) + "\n").encode())
        except OSError:
            os.close(self._fd)
            raise

    @property
    def backlog(self) -> int:
        """Rows waiting to be written."""
        return len(self._queue)


class CsvWriter:
    """The writer thread and its tables.

    A full or broken disk does not raise in a callback: ``error`` states what happened, later rows
    are counted as dropped, and ``close`` still returns.
    """

    def __init__(self, wake_s: float = WAKE_S) -> None:
        self.error: str | None = None
        """Why writing stopped; None if it has not."""
        self.tables: list[CsvTable] = []
        self._wake_s = wake_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="csv_writer", daemon=True)
        self._thread.start()

    def table(self, path: Path, columns: Sequence[str], queue_limit: int | None = None) -> CsvTable:
        """Create a table, or raise an OSError; ``queue_limit`` rows may wait (None: unlimited)."""
        table = CsvTable(path, columns, queue_limit)
        self.tables = [*self.tables, table]  # a new list: the thread iterates over the old one
        return table

    def put(self, table: CsvTable, row: Row) -> bool:
        """Queue a row; False if it was dropped (and counted). Never blocks."""
        if self.error is not None or (
            table.queue_limit is not None and len(table._queue) >= table.queue_limit
        ):
            table.dropped += 1
            return False
        table._queue.append(row)
        table.taken = next(table._numbers)
        return True

    def flush(self, timeout_s: float) -> bool:
        """Wait until every queued row is with the kernel; False after the timeout."""
        deadline = time.monotonic() + timeout_s
        while any(t.backlog for t in self.tables) and self.error is None:
            if time.monotonic() > deadline:
                return False
            time.sleep(self._wake_s / 2)
        return self.error is None

    def close(self) -> None:
        """Write what is queued, sync to disk, close. May be called twice."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join()
        for table in self.tables:
            try:
                os.fsync(table._fd)
            except OSError as problem:
                self._fail(table, problem)
            finally:
                os.close(table._fd)

    def _run(self) -> None:
        while not self._stop.wait(self._wake_s):
            self._drain()
        self._drain()

    def _drain(self) -> None:
        for table in self.tables:
            while table.backlog:
                if self.error is not None:
                    table.dropped += table.backlog
                    table._queue.clear()
                    break
                self._write(table)

    def _write(self, table: CsvTable) -> None:
        """Write up to one batch. Rows leave the queue only when the kernel has them."""
        queue = table._queue
        rows = [queue[i] for i in range(min(BATCH, len(queue)))]
        data, done = _lines(rows), 0
        try:
            while done < len(data):
                done += os.write(table._fd, data[done:])
        except OSError as problem:
            self._fail(table, problem)
            rows = rows[: data.count(b"\n", 0, done)]  # a full disk may still take some
        table.rows += len(rows)
        for row in rows:
            table.last = row
            queue.popleft()

    def _fail(self, table: CsvTable, problem: OSError) -> None:
        if self.error is None:
            self.error = f"{table.path.name}: {problem.strerror or problem}"


def _lines(rows: Iterable[Row]) -> bytes:
    return ("\n".join(map(format_row, rows)) + "\n").encode("utf-8", "replace")
