"""Reads the box structure of a fragmented MP4 file, without decoding anything.

Such a file is a sequence of boxes: ``ftyp``, ``moov`` (no frames), then for every fragment ``moof``
(how many frames, how long) and ``mdat`` (the frames), and ``mfra`` (an index) if it was closed.
Source: ISO/IEC 14496-12, boxes ``moof``, ``traf``, ``trun``.
"""

from __future__ import annotations

import dataclasses
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

_HEAD = struct.Struct(">I4s")


@dataclasses.dataclass(frozen=True)
class Fragment:
    """A complete fragment: its end in the file, and its number of frames."""

    end: int
    frames: int


def fragments(path: Path) -> list[Fragment]:
    """The complete fragments of a file, in order."""
    complete: list[Fragment] = []
    with open(path, "rb") as file:
        frames: int | None = None
        for kind, start, end in _boxes(file, 0, _written(file)):
            if kind == b"moof":
                frames = _frames(file, start, end)
            elif kind == b"mdat" and frames is not None:
                complete.append(Fragment(end, frames))
                frames = None
    return complete


def is_closed(path: Path) -> bool:
    """Whether the file ends with the index that closing it writes."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        boxes = list(_boxes(file, 0, size))
    return bool(boxes) and boxes[-1][0] == b"mfra" and boxes[-1][2] == size


def is_plain(path: Path) -> bool:
    """Whether it is an MP4 without fragments."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        kinds = {kind for kind, _, _ in _boxes(file, 0, size)}
    return b"mdat" in kinds and b"moof" not in kinds


def _written(file: BinaryIO) -> int:
    """Size without the zeros that a machine leaves at the end when it goes down.

    Neither a coded picture nor the index ends with a zero (H.264 ends it with a one and its
    padding, ``mfra`` with its size).
    """
    end = file.seek(0, os.SEEK_END)
    while end > 0:
        start = max(0, end - 65536)
        file.seek(start)
        kept = len(file.read(end - start).rstrip(b"\0"))
        if kept:
            return start + kept
        end = start
    return 0


def _boxes(file: BinaryIO, start: int, stop: int) -> Iterator[tuple[bytes, int, int]]:
    """Kind, start and end of the complete boxes between two positions."""
    while start + _HEAD.size <= stop:
        file.seek(start)
        size, kind = _HEAD.unpack(file.read(_HEAD.size))
        if size == 1:
            long = file.read(8)
            if len(long) < 8:
                return
            (size,) = struct.unpack(">Q", long)
        if size < _HEAD.size or start + size > stop:
            return  # cut, or not written at all (zeros)
        yield kind, start, start + size
        start += size


def _frames(file: BinaryIO, start: int, end: int) -> int:
    """Number of frames that a ``moof`` announces: the sum over its runs."""
    count = 0
    for kind, first, last in list(_boxes(file, start + _HEAD.size, end)):
        if kind != b"traf":
            continue
        for inner, place, _ in list(_boxes(file, first + _HEAD.size, last)):
            if inner == b"trun":
                file.seek(place + _HEAD.size + 4)  # behind version and flags
                count += int(struct.unpack(">I", file.read(4))[0])
    return count
