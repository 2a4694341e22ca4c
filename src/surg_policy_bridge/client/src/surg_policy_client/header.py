"""A header's map, read with limits on everything.

msgpack reads what cannot contain anything; lists and maps are put together here. Its own C reader
never frees those that it has begun when a message turns out wrong (before msgpack-python's pull
request 671 of 2026): 100 kB for each such message, and anybody may send one.
"""

from __future__ import annotations

from typing import Any, Union

import msgpack

Buffer = Union[bytes, memoryview]

MAX_TEXT = 1 << 16
"""Bytes of a text."""
MAX_LIST = 1024
MAX_MAP = 256
MAX_DEPTH = 16
"""Lists and maps within one another."""
MAX_VALUES = 1 << 14
"""All in all; reading so many takes some 10 ms, and meanwhile nothing else is read."""


def read_map(data: Buffer) -> dict[str, Any]:
    """The map that these bytes are.

    Raises:
        ValueError: They are no map, are cut off or go on behind it, hold a key twice or one that is
            no text, bytes or an extension type, a text that is not UTF-8, or exceed a limit.
    """
    found = _Reader(data).all()
    if type(found) is not dict:
        raise ValueError(f"a map, not {type(found).__name__}")
    return found


class _Reader:
    """Reads values one behind the other.

    Args:
        data: All of them.
    """

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
        """The one value that there is."""
        try:
            found = self._value(0)
        except (IndexError, msgpack.OutOfData):
            raise ValueError("it is cut off") from None
        rest = len(self._data) - self._plain.tell()
        if rest:
            raise ValueError(f"{rest} bytes stand behind it")
        return found

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
        found: dict[str, Any] = {}
        for _ in range(count):
            key = self._value(depth)
            if type(key) is not str:
                raise ValueError(f"a key is a text, not {type(key).__name__}")
            if key in found:
                raise ValueError(f"the key {key[:100]!r} stands twice")
            found[key] = self._value(depth)
        return found

    def _list(self, depth: int) -> list[Any]:
        count = _at_most(self._plain.read_array_header(), MAX_LIST, depth)
        return [self._value(depth) for _ in range(count)]


def _at_most(count: int, most: int, depth: int) -> int:
    if count > most:
        raise ValueError(f"{count} entries; at most {most}")
    if depth > MAX_DEPTH:
        raise ValueError(f"lists and maps more than {MAX_DEPTH} deep")
    return count
