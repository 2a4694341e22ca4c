"""The outer structure of MP4 files, box by box; and mutants: that each of these checks can fail."""

from __future__ import annotations

import importlib.util
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from surg_recording.video import mp4_boxes

Module = Any
PICTURE = b"\x65coded\x80"
"""What a coded picture ends with is never a zero."""


def box(kind: bytes, *parts: bytes, long: bool = False) -> bytes:
    """A box of some kind; with the long form of its size where asked for."""
    data = b"".join(parts)
    if long:
        return struct.pack(">I4sQ", 1, kind, 16 + len(data)) + data
    return struct.pack(">I4s", 8 + len(data), kind) + data


def trun(frames: int) -> bytes:
    """A run: version and flags, number of frames, one entry each."""
    return box(b"trun", struct.pack(">II", 0x01000F01, frames), bytes(8 * frames))


def moof(*runs: int) -> bytes:
    """The head of a fragment of one track with runs of so many frames."""
    return box(
        b"moof", box(b"mfhd", bytes(8)), box(b"traf", box(b"tfhd", bytes(8)), *map(trun, runs))
    )


HEAD = box(b"ftyp", b"isom") + box(b"moov", bytes(40))
INDEX = box(b"mfra", box(b"mfro", b"\0\0\0\0\0\0\0\x18"))
ONE = moof(4) + box(b"mdat", PICTURE * 4)
TWO = moof(2, 3) + box(b"mdat", PICTURE * 5, long=True)


class Cases:
    """Everything that is asked of the module; ``found`` are the fragments of a file."""

    def __init__(self, module: Module, folder: Path) -> None:
        self.module, self.file = module, folder / "v.mp4"

    def found(self, data: bytes) -> list[tuple[int, int]]:
        """(end, frames) of the whole fragments."""
        self.file.write_bytes(data)
        return [(f.end, f.frames) for f in self.module.fragments(self.file)]

    def runs_are_added_up_and_sizes_may_be_long(self) -> None:
        data = HEAD + ONE + TWO + INDEX
        first, second = len(HEAD + ONE), len(HEAD + ONE + TWO)
        assert self.found(data) == [(first, 4), (second, 5)]

    def a_cut_fragment_does_not_count(self) -> None:
        data, first = HEAD + ONE + TWO, len(HEAD + ONE)
        for size in range(first, len(data), 3):
            assert self.found(data[:size]) == [(first, 4)], size
        for size in range(0, first, 3):
            assert self.found(data[:size]) == [], size

    def pictures_without_a_head_do_not_count(self) -> None:
        stray = box(b"mdat", PICTURE)
        assert self.found(HEAD + stray + ONE) == [(len(HEAD + stray + ONE), 4)]
        old = box(b"free", box(b"traf", trun(3)))  # a head that was taken back
        assert self.found(HEAD + old + stray) == []
        assert self.found(HEAD + ONE + stray) == [(len(HEAD + ONE), 4)], "one head, one fragment"
        assert self.found(HEAD + moof(7) + ONE) == [(len(HEAD + moof(7) + ONE), 4)]

    def space_that_was_never_written_does_not_count(self) -> None:
        """A power cut: the file has its size, its end is zeros."""
        whole = HEAD + ONE
        for zeros in (1, 3, 500, 200_000):
            assert self.found(whole + bytes(zeros)) == [(len(whole), 4)], zeros
            lost = moof(9) + box(b"mdat", PICTURE, bytes(zeros))
            assert self.found(whole + lost) == [(len(whole), 4)], zeros

    def sizes_that_cannot_be_end_the_reading(self) -> None:
        for size in (2, 7):
            broken = struct.pack(">I4s", size, b"free")
            assert self.found(HEAD + ONE + broken + TWO) == [(len(HEAD + ONE), 4)], size
        inside = struct.pack(">I", 4)  # behind these four bytes there would be boxes again
        assert self.found(HEAD + ONE + inside + TWO) == [(len(HEAD + ONE), 4)]
        huge = struct.pack(">I4sQ", 1, b"free", 1 << 40)
        assert self.found(HEAD + ONE + huge + TWO) == [(len(HEAD + ONE), 4)]
        assert self.found(b"") == self.found(b"\x00\x00") == []

    def a_box_may_have_more_than_4_gib(self) -> None:
        size = (1 << 32) + 1000
        begin = len(HEAD + moof(4))
        self.file.write_bytes(HEAD + moof(4) + struct.pack(">I4sQ", 1, b"mdat", size))
        with open(self.file, "rb+") as file:  # the rest is a hole, which takes no space
            file.seek(begin + size - 1)
            file.write(b"\x80" + ONE)
        found = [(f.end, f.frames) for f in self.module.fragments(self.file)]
        assert found == [(begin + size, 4), (begin + size + len(ONE), 4)]

    def what_is_no_track_holds_no_frames(self) -> None:
        other = box(
            b"moof", box(b"uuid", trun(50)), trun(60), box(b"traf", box(b"free", trun(7)), trun(3))
        )
        data = HEAD + other + box(b"mdat", PICTURE)
        assert self.found(data) == [(len(data), 3)]

    def only_a_file_with_its_index_at_the_end_is_closed(self) -> None:
        for data, closed in (
            (HEAD + ONE + INDEX, True),
            (HEAD + ONE, False),
            (HEAD + ONE + INDEX[:-1], False),
            (HEAD + ONE + INDEX + b"\0", False),
            (HEAD + INDEX + ONE, False),
            (b"", False),
        ):
            self.file.write_bytes(data)
            assert self.module.is_closed(self.file) is closed

    def a_file_without_fragments_is_plain(self) -> None:
        pictures = box(b"mdat", PICTURE)
        for data, plain in (
            (HEAD + pictures, True),
            (HEAD + ONE, False),
            (HEAD + pictures + ONE, False),
            (HEAD, False),
            (b"", False),
        ):
            self.file.write_bytes(data)
            assert self.module.is_plain(self.file) is plain


CASES: list[Callable[[Cases], None]] = [
    case for name, case in vars(Cases).items() if not name.startswith("_") and name != "found"
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_of_boxes(case: Callable[[Cases], None], tmp_path: Path) -> None:
    case(Cases(mp4_boxes, tmp_path))


MUTANTS = {
    "the last run counts alone": ("count += int(", "count = int("),
    "the flags are taken for a count": ("place + _HEAD.size + 4", "place + _HEAD.size"),
    "any box holds tracks": ('if kind != b"traf":', 'if kind == b"mfhd":'),
    "any box is a run": ('if inner == b"trun":', 'if inner != b"tfhd":'),
    "a cut box is whole": ("or start + size > stop", ""),
    "long sizes are not known": ("if size == 1:", "if size == -1:"),
    "a long size is its low half": ('">Q", long)', '">I", long[4:])'),
    "a box may be smaller than its head": ("if size < _HEAD.size or", "if size < 1 or"),
    "zeros are pictures": ("_boxes(file, 0, _written(file))", "_boxes(file, 0, file.seek(0, 2))"),
    "of zeros the last block alone is seen": (
        "end = start\n    return 0",
        "return end\n    return 0",
    ),
    "a byte too much is cut of the zeros": ("return start + kept", "return start + kept - 1"),
    "pictures without a head count": (
        'elif kind == b"mdat" and frames is not None:',
        'elif kind == b"mdat":\n                frames = frames or 0',
    ),
    "a head counts twice": ("frames))\n                frames = None", "frames))"),
    "a fragment ends before its pictures": ("Fragment(end, frames)", "Fragment(start, frames)"),
    "a head of any kind": ('if kind == b"moof":', 'if kind in (b"moof", b"free"):'),
    "an index anywhere closes": ('boxes[-1][0] == b"mfra"', 'any(b[0] == b"mfra" for b in boxes)'),
    "a cut index closes": ("and boxes[-1][2] == size", ""),
    "an empty file is closed": ("return bool(boxes) and", "return not boxes or"),
    "with fragments it is plain too": (' and b"moof" not in kinds', ""),
    "without pictures it is plain": ('b"mdat" in kinds and', ""),
}
"""Text of mp4_boxes.py that occurs once, and what the mutant has there."""


def noticed(module: Module, folder: Path) -> str | None:
    """Name of the first case that fails."""
    for case in CASES:
        try:
            case(Cases(module, folder))
        except Exception:  # however it shows
            return case.__name__
    return None


@pytest.mark.parametrize("name", MUTANTS)
def test_every_mutant_is_noticed(name: str, tmp_path: Path) -> None:
    text, instead = MUTANTS[name]
    source = Path(mp4_boxes.__file__).read_text("utf-8")
    assert source.count(text) == 1, "the code has changed: renew the mutant"
    file = tmp_path / "mutant_boxes.py"
    file.write_text(source.replace(text, instead), "utf-8")
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[file.stem] = module  # dataclasses look it up there
    try:
        spec.loader.exec_module(module)
        failed = noticed(module, tmp_path)
    finally:
        del sys.modules[file.stem]
    print(f"{name}: {failed}")
    assert failed is not None
