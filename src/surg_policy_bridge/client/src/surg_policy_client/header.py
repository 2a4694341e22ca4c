"""Reads the map of a header with limits on everything.

msgpack reads the scalars; lists and maps are assembled here. Before pull request 671 of
msgpack-python its C reader leaked unfinished lists and maps of invalid messages, 100 kB each.
"""

from __future__ import annotations

from typing import Any, Union

import msgpack

Buffer = Union[bytes, memoryview]

MAX_TEXT = 1 << 16
"""[bytes] Longest text."""
MAX_LIST = 1024
MAX_MAP = 256
MAX_DEPTH = 16
"""Nesting of lists and maps."""
MAX_VALUES = 1 << 14
"""Values in total; reading so many takes about 10 ms."""


def read_map(data: Buffer) -> dict[str, Any]:
    """Read one map.

    Raises:
        ValueError: It is not a map, is truncated or has trailing bytes; it has a duplicate key or
            one that is not a text, bytes, an extension type or invalid UTF-8; or exceeds a limit.
    """
    value = _Reader(data).all()
    if type(value) is not dict:
        raise ValueError(f"a {type(value).__name__}, not a map")
    return value


class _Reader:
    """Reads values in sequence."""

    def __init__(self, data: Buffer) -> None:
        self._data = data
        size = max(len(data), 1)
        self._plain = msgpack.Unpacker(
            raw=False,
            max_str_len=MAX_TEXT,
            max_bin_len=0,
            max_ext_len=0,
            read_size=size,
            max_buffer_size=size,
        )
        self._plain.feed(data)
        self._left = MAX_VALUES

    def all(self) -> Any:
        """The only value."""
        try:
            value = self._value(0)
        except (IndexError, msgpack.OutOfData):
            raise ValueError("it is truncated") from None
        rest = len(self._data) - self._plain.tell()
        if rest:
            raise ValueError(f"{rest} trailing bytes")
        return value

    def _value(self, depth: int) -> Any:
        first = self._data[self._plain.tell()]
        self._left -= 1
        if self._left < 0:
            raise ValueError(f"more than {MAX_VALUES} values")
        if 0x80 <= first <= 0x8F or first in (0xDE, 0xDF):
            return self._map(depth + 1)
        if 0x90 <= first <= 0x9F or first in (0xDC, 0xDD):
            return self._list(depth + 1)
        return self._plain.unpack()

    def _map(self, depth: int) -> dict[str, Any]:
        count = _at_most(self._plain.read_map_header(), MAX_MAP, depth)
        fields: dict[str, Any] = {}
        for _ in range(count):
            key = self._value(depth)
            if type(key) is not str:
                raise ValueError(f"a key of type {type(key).__name__}; allowed: text")
            if key in fields:
                raise ValueError(f"the key {key[:100]!r} is there twice")
            fields[key] = self._value(depth)
        return fields

    def _list(self, depth: int) -> list[Any]:
        count = _at_most(self._plain.read_array_header(), MAX_LIST, depth)
        return [self._value(depth) for _ in range(count)]


def _at_most(count: int, most: int, depth: int) -> int:
    if count > most:
        raise ValueError(f"{count} entries; at most {most}")
    if depth > MAX_DEPTH:
        raise ValueError(f"lists and maps more than {MAX_DEPTH} deep")
    return count
