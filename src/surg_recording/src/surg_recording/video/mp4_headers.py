"""Repairs overwritten headers of the boxes of a fragmented MP4 file.

A box begins with its size and its kind. If these eight bytes are overwritten, a player finds no
frame behind them, although all of them are there. The next intact box shows where the damaged one
ends, and the order of boxes what it is. Source: ISO/IEC 14496-12, 4.2 and 8.8.
"""

from __future__ import annotations

import mmap
import re
import struct
from pathlib import Path
from typing import BinaryIO

_HEAD = struct.Struct(">I4s")
_NEXT = {b"": b"ftyp", b"ftyp": b"moov", b"moov": b"moof", b"moof": b"mdat", b"mdat": b"moof"}
"""The box that follows in a file of the recorder."""
_OTHERS = b"mfra free skip wide styp sidx ssix udta uuid meta pdin prft emsg"
_KINDS = {*_NEXT.values(), *_OTHERS.split()}
_CANDIDATES = re.compile(b"moov|moof|mdat|mfra")


def repair(path: Path) -> list[str]:
    """Write overwritten headers anew, in place; a sentence per header. May raise OSError."""
    if path.stat().st_size < 2 * _HEAD.size:
        return []
    with open(path, "rb+") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return [_write(file, path.name, data, *found) for found in _damaged(data)]


def _damaged(data: mmap.mmap) -> list[tuple[int, int, bytes]]:
    """Start, end and kind of every box with an overwritten header."""
    found = []
    place, before = 0, b""
    while place + _HEAD.size <= len(data):
        kind, end = _box(data, place)
        if end is None or not _continues(data, end):
            following = _following(data, place + _HEAD.size)
            if following is None:
                break  # the file ends in this box, or behind it
            after = bytes(data[following + 4 : following + 8])
            own = kind if kind in _KINDS else _NEXT.get(before, b"free")
            if end is None or (end != following and after == _NEXT.get(own)):
                end = following
                own = own if after == _NEXT.get(own) or own in _KINDS - {after} else b"free"
                found.append((place, end, own))
            kind = own
        place, before = end, kind
    return found


def _box(data: mmap.mmap, place: int) -> tuple[bytes, int | None]:
    """Kind and end of the box at a position; no end: its header cannot be right."""
    size, kind = _HEAD.unpack(data[place : place + _HEAD.size])
    if size == 1 and place + 16 <= len(data):
        (size,) = struct.unpack(">Q", data[place + 8 : place + 16])
    right = kind in _KINDS and size >= _HEAD.size and place + size <= len(data)
    return kind, place + size if right else None


def _continues(data: mmap.mmap, end: int) -> bool:
    """Whether the file ends here, or a box of a known kind begins."""
    return end + _HEAD.size > len(data) or bytes(data[end + 4 : end + 8]) in _KINDS


def _following(data: mmap.mmap, start: int) -> int | None:
    """The next position at which an intact box begins, with another one or the end behind it."""
    for match in _CANDIDATES.finditer(data, start + 4):
        place = match.start() - 4
        _, end = _box(data, place)
        if end is not None and _continues(data, end):
            return place
    return None


def _write(file: BinaryIO, name: str, data: mmap.mmap, place: int, end: int, kind: bytes) -> str:
    was = bytes(data[place : place + _HEAD.size]).hex()
    if end - place < 1 << 32:
        file.seek(place)
        file.write(_HEAD.pack(end - place, kind))
    return f"{name}: the header of box {kind.decode()} at byte {place} was {was}, written anew"
