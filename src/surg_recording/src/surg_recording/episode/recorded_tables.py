"""The tables of an episode that is being recorded: each is created when it is first needed."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording.clock.clock_steps import FUTURE_NS
from surg_recording.episode.csv_sink import CsvTable, CsvWriter
from surg_recording.episode.episode_reader import TOPICS
from surg_recording.episode.table_rows import Row

FREERUN_QUEUE = 5000
"""Rows per table that may wait in free-run: 10 s at 500 Hz."""


class RecordedTables:
    """Tables by name. All methods may be called from any thread.

    Args:
        folder: The folder of the episode.
        lockstep: Whether the time is simulated; then no row is dropped and no stamp is early.
        problems: Receives why a table or a row is missing.
    """

    def __init__(self, folder: Path, lockstep: bool, problems: list[str]) -> None:
        self.writer = CsvWriter()
        self.future: dict[str, int] = {}
        """Stamps in the future, by table or camera."""
        self._folder, self._lockstep, self._problems = folder, lockstep, problems
        self._lock = threading.Lock()
        self._tables: dict[str, CsvTable] = {}

    def all(self) -> dict[str, CsvTable]:
        """The tables so far, by name."""
        return dict(self._tables)

    def get(self, name: str) -> CsvTable | None:
        """The table of this name; None if there is none."""
        return self._tables.get(name)

    def open(self, name: str, columns: Sequence[str], limit: int | None = None) -> CsvTable | None:
        """The table of this name, created with these columns if new; None if that fails."""
        if table := self._tables.get(name):
            return table
        limit = limit or (None if self._lockstep else FREERUN_QUEUE)
        with self._lock:
            if name not in self._tables:
                path = self._folder / f"{name}.csv"
                try:
                    self._tables[name] = self.writer.table(path, columns, limit)
                except OSError as problem:
                    self._problems.append(f"{name}: {problem.strerror}")
                    return None
            return self._tables[name]

    def open_topic(
        self, name: str, columns: Sequence[str], about: Mapping[str, Any]
    ) -> CsvTable | None:
        """Create a table below ``topics/``, with facts for a reader beside it."""
        folder = self._folder / TOPICS
        try:
            folder.mkdir(exist_ok=True)
            # Not synced: a callback calls this and must not wait for the disk.
            (folder / f"{name}.json").write_text(json.dumps(about, indent=1) + "\n", "utf-8")
        except OSError as problem:
            self._problems.append(f"{TOPICS}/{name}: {problem.strerror}")
            return None
        # Further topics are never waited for, even in lock-step: their queues are always bounded.
        return self.open(f"{TOPICS}/{name}", columns, FREERUN_QUEUE)

    def put(self, table: CsvTable | None, row: Row) -> None:
        """Queue a row that begins with its stamp and reception [ns]."""
        if table is not None:
            self.count_future_stamp(table.path.stem, row[0], row[1])
            self.writer.put(table, row)

    def put_fitting(self, table: CsvTable | None, row: Row, what: str) -> None:
        """Queue a row if it has as many fields as its table."""
        if table is not None and len(row) != len(table.columns):
            self._problems.append(f"{table.path.stem}: a message with another {what}")
            table.dropped += 1
            return
        self.put(table, row)

    def count_future_stamp(self, name: str, stamp_ns: int, receive_ns: int) -> None:
        """Count a stamp in the future; lock-step stamps are simulated time and do not count."""
        if stamp_ns > receive_ns + FUTURE_NS and not self._lockstep:
            self.future[name] = self.future.get(name, 0) + 1

    def written_tick(self, arms: Sequence[str]) -> int:
        """Newest tick whose cycles and ground truths of all arms have been handed to the kernel."""
        ticks = []
        for arm in arms:
            for name in (f"cycle_{arm}", f"ground_truth_{arm}"):
                table = self._tables.get(name)
                column = 2  # both tables: stamp_ns, receive_ns, tick
                ticks.append(table.last[column] if table is not None and table.last else 0)
        return min(ticks, default=0)
