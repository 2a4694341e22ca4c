"""Sets damaged data aside: recovery never deletes anything that was recorded.

What was cut from ``x.csv`` is in ``x.csv.damaged``, and a file that is of no use becomes
``x.csv.damaged`` as a whole. If that name is taken, ``x.csv.2.damaged``, … is used.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from surg_recording.file_io import write_all

SUFFIX = ".damaged"
_BLOCK = 1 << 20


def set_aside(path: Path) -> str:
    """Rename a file; returns its new name. An empty file is removed, and the name is empty."""
    if is_regular(path) and path.lstat().st_size == 0:
        path.unlink()
        return ""
    target = _free_name(path)
    os.rename(path, target)
    return target.name


def cut(path: Path, end: int) -> str:
    """Truncate a file; what was behind ``end`` goes into a file of its own, whose name is returned.

    Zeros at the end, which a machine leaves when it goes down, hold nothing and are dropped; the
    name is empty if there is nothing else. May raise OSError: then nothing has been cut.
    """
    kept = ""
    size = path.stat().st_size
    with open(path, "rb+") as file:
        last = _last_byte(file.fileno(), end, size)
        if last > end:
            target = _free_name(path)
            _copy(file.fileno(), end, last, target)
            kept = target.name
        file.truncate(end)
        os.fsync(file.fileno())
    return kept


def cut_words(path: Path, removed: int, kept: str) -> str:
    """What is said of a cut: ``kept`` is the name that ``cut`` returned."""
    where = f"kept in {kept}" if kept else "all zeros"
    return f"{path.name}: its end was broken: {removed} bytes cut, {where}"


def is_regular(path: Path) -> bool:
    """Whether a file lies there itself: no link, folder or named pipe."""
    return stat.S_ISREG(path.lstat().st_mode)


def _free_name(path: Path) -> Path:
    for number in range(1, 10_000):
        name = f"{path.name}{SUFFIX}" if number == 1 else f"{path.name}.{number}{SUFFIX}"
        if not os.path.lexists(target := path.with_name(name)):
            return target
    raise OSError(17, "too many damaged files of this name", str(path))


def _last_byte(fd: int, start: int, end: int) -> int:
    """End of what is not zero between two positions of a file."""
    while end > start:
        begin = max(start, end - _BLOCK)
        data = os.pread(fd, end - begin, begin).rstrip(b"\0")
        if data:
            return begin + len(data)
        end = begin
    return start


def _copy(fd: int, start: int, end: int, target: Path) -> None:
    out = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
    try:
        while start < end:
            data = os.pread(fd, min(_BLOCK, end - start), start)
            write_all(out, data)
            start += len(data)
        os.fsync(out)
    except OSError:
        os.unlink(target)
        raise
    finally:
        os.close(out)
