"""Tables of topics of any type: their columns, and when a further table is needed.

A table's columns are those of its first message. A message with a longer array does not fit: a
further table of the topic begins, with columns for both. Values are never shifted or lost silently.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from surg_recording.episode.csv_sink import CsvTable
from surg_recording.episode.message_fields import Flat, columns_for, file_name

MAX_TABLES = 16
"""Most tables of one topic; a message that fits none is truncated, with a warning."""

Opener = Callable[[str, Sequence[str], Mapping[str, Any]], CsvTable | None]


@dataclasses.dataclass
class _Topic:
    kind: str
    messages: int = 0
    cut: int = 0
    tables: list[str] = dataclasses.field(default_factory=list)
    table: CsvTable | None = None
    columns: dict[str, str] = dataclasses.field(default_factory=dict)
    full: bool = False

    def fits(self, flat: Flat) -> bool:
        """Whether the newest table has a column for every value."""
        return self.table is not None and flat.values.keys() <= self.columns.keys()


class TopicTables:
    """The tables of all further topics of one episode. May be used from any thread.

    Args:
        opener: Creates a table from a file name, its columns, and facts for a reader.
        warn: Called with a sentence when a message cannot be kept complete.
    """

    def __init__(self, opener: Opener, warn: Callable[[str], None]) -> None:
        self._opener, self._warn = opener, warn
        self._lock = threading.Lock()
        self._known: dict[str, _Topic] = {}
        self._names: set[str] = set()

    def table(self, topic: str, kind: str, flat: Flat) -> CsvTable | None:
        """The table for a message; None if there can be none."""
        with self._lock:
            known = self._known.get(topic)
            if known is None:
                known = self._known[topic] = _Topic(kind)
            elif known.kind != kind:  # another publisher, another type
                known.kind, known.table, known.columns = kind, None, {}
            known.messages += 1
            if flat.cut:
                known.cut += 1
                for what in flat.cut:
                    self._warn(f"{topic}: {what.partition(' has ')[0]} is too long: it is cut")
            if not known.fits(flat) and not known.full:
                self._open(topic, known, flat)
            return known.table

    def describe(self) -> dict[str, dict[str, Any]]:
        """By topic: type, number of messages, tables, messages that were cut."""
        with self._lock:
            return {
                topic: {
                    "type": known.kind,
                    "messages": known.messages,
                    "tables": list(known.tables),
                    "cut": known.cut,
                }
                for topic, known in self._known.items()
            }

    def _open(self, topic: str, known: _Topic, flat: Flat) -> None:
        columns = columns_for(flat, known.columns)
        if len(known.tables) >= MAX_TABLES:
            known.full = True
            self._warn(f"{topic}: its arrays grew through {MAX_TABLES} tables: longer ones are cut")
            return
        base = name = file_name(topic)
        number = 1
        while name in self._names:
            number += 1
            name = f"{base}.{number}"
        about = {"topic": topic, "type": known.kind, "kinds": columns}
        table = self._opener(name, list(columns), about)
        if table is None:
            known.full = True
            return
        self._names.add(name)
        known.table, known.columns = table, columns
        known.tables.append(f"topics/{name}")
