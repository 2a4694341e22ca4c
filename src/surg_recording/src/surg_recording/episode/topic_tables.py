"""Tables of topics of any type: their columns, and when a further table is needed.

A table's columns are those of its first message. A message with a longer array does not fit: a
further table of the topic begins, with columns for both. Values are never shifted or lost silently.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from surg_recording.episode.csv_sink import CsvTable
from surg_recording.episode.message_fields import Flat, columns_for, file_name

MAX_TABLES = 16
"""Tables of one topic; what fits none of them then is cut, and said."""

Opener = Callable[[str, Sequence[str], Mapping[str, Any]], CsvTable | None]


class TopicTables:
    """The tables of all further topics of one episode. May be used from any thread.

    Args:
        opener: Creates a table from a file name, its columns, and facts for a reader.
        note: Called with (topic, sentence) when a message cannot be kept complete.
    """

    def __init__(self, opener: Opener, note: Callable[[str, str], None]) -> None:
        self._opener, self._note = opener, note
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
                    self._note(topic, what.partition(" has ")[0] + " is too long: it is cut")
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
            self._note(topic, f"its arrays grew through {MAX_TABLES} tables: what is longer is cut")
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


class _Topic:
    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.messages = self.cut = 0
        self.tables: list[str] = []
        self.table: CsvTable | None = None
        self.columns: dict[str, str] = {}
        self.full = False

    def fits(self, flat: Flat) -> bool:
        """Whether the newest table has a column for every value."""
        return self.table is not None and flat.values.keys() <= self.columns.keys()
