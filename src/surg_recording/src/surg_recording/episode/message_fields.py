"""Any ROS message as named values, without ROS.

A message is any object with ``__slots__`` and ``_slot_types`` as genpy makes them. A nested field
``pose.position.x`` keeps that name; item i of an array ``name`` is ``name_i``, and an array of
variable length has its true length in ``name.length``. A time or duration ``name`` becomes integer
nanoseconds ``name_ns``. Bytes are text in hexadecimal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from surg_recording.episode.table_rows import nanoseconds

MAX_ITEMS = 256
"""Items of an array that are kept; its true length stays known."""

MAX_BYTES = 1024
"""Bytes of an array of bytes that are kept: it is one value, whatever its length."""

MAX_VALUES = 2000
"""Values of a message that are kept."""

FIRST = ("stamp_ns", "receive_ns", "source")
"""Columns before those of the message: header stamp (0: it has none), reception, caller id."""

_BYTES = frozenset(("uint8", "char"))
_INTEGERS = frozenset(
    ("bool", "byte", "char", *(f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64)))
)


class Flat:
    """A message as values by column.

    Attributes:
        stamp_ns: Stamp of the message's header [ns]; 0 without one.
        values: Column → value; bools are integers.
        kinds: Column → ``int``, ``float`` or ``text``.
        cut: What was too long and truncated, in words.
    """

    def __init__(self, message: Any) -> None:
        self.stamp_ns = 0
        self.values: dict[str, Any] = {}
        self.kinds: dict[str, str] = {}
        self.cut: list[str] = []
        header = getattr(message, "header", None)
        stamp = getattr(header, "stamp", None)
        if stamp is not None:
            self.stamp_ns = nanoseconds(stamp)
        self._message(message, "", skip_stamp=stamp is not None)

    def row(self, columns: Sequence[str], receive_ns: int, source: str) -> tuple[Any, ...]:
        """The row for these columns; None for a value that the message does not have."""
        get = self.values.get
        return (self.stamp_ns, receive_ns, source, *map(get, columns[len(FIRST) :]))

    def _message(self, message: Any, prefix: str, skip_stamp: bool = False) -> None:
        for slot, kind in zip(message.__slots__, message._slot_types, strict=True):
            name, value = prefix + slot, getattr(message, slot)
            if skip_stamp and name == "header.stamp":
                continue
            base, bracket, size = kind.partition("[")
            if not bracket:
                self._value(name, base, value, skip_stamp)
            elif base in _BYTES:
                self._bytes(name, bytes(value))
            else:
                if size == "]":  # of variable length
                    self._put(f"{name}.length", "int", len(value))
                if len(value) > MAX_ITEMS:
                    self.cut.append(f"{name} has {len(value)} items, {MAX_ITEMS} are kept")
                for index, item in enumerate(value[:MAX_ITEMS]):
                    self._value(f"{name}_{index}", base, item)

    def _value(self, name: str, base: str, value: Any, skip_stamp: bool = False) -> None:
        if base in ("time", "duration"):
            self._put(f"{name}_ns", "int", nanoseconds(value))
        elif base == "string":
            self._put(name, "text", value if isinstance(value, str) else repr(value))
        elif base in _INTEGERS:
            self._put(name, "int", int(value))
        elif base in ("float32", "float64"):
            self._put(name, "float", float(value))
        else:
            self._message(value, f"{name}.", skip_stamp and name == "header")

    def _bytes(self, name: str, value: bytes) -> None:
        self._put(f"{name}.length", "int", len(value))
        if len(value) > MAX_BYTES:
            self.cut.append(f"{name} has {len(value)} bytes, {MAX_BYTES} are kept")
        self._put(name, "text", value[:MAX_BYTES].hex())

    def _put(self, name: str, kind: str, value: Any) -> None:
        if len(self.values) >= MAX_VALUES:
            limit = f"more than {MAX_VALUES} values"
            if limit not in self.cut:
                self.cut.append(limit)
            return
        while name in FIRST or name in self.values:
            name += "_"
        self.values[name], self.kinds[name] = value, kind


def columns_for(flat: Flat, earlier: Mapping[str, str]) -> dict[str, str]:
    """Columns with kinds of a table for this message and for those of the ``earlier`` table."""
    first = {"stamp_ns": "int", "receive_ns": "int", "source": "text"}
    return {**first, **flat.kinds, **{k: v for k, v in earlier.items() if k not in flat.kinds}}


def file_name(topic: str) -> str:
    """File name of a topic: ``/PSM1/jaw/measured_js`` is ``PSM1_jaw_measured_js``."""
    return topic.strip("/").replace("/", "_") or "root"
