"""Safe reads and durable writes of files."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import resource
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from surg_recording.recording_errors import EpisodeError

MOST_MEMORY = 4 << 30
"""Memory that one recording of others may take [bytes]: a few bytes can unpack to any size."""

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISCHR, "a device"),
)


def regular_file(path: Path) -> Path:
    """The path, if a regular file lies there: to open a named pipe would wait for ever.

    Raises:
        EpisodeError: Nothing lies there, something else does, or the path cannot be followed.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise EpisodeError(f"{path}: the file is missing") from None
    except OSError as problem:
        raise EpisodeError(f"{path}: cannot be read ({problem.strerror})") from None
    if not stat.S_ISREG(mode):
        kind = next((words for test, words in _KINDS if test(mode)), "something else")
        raise EpisodeError(f"{path}: is {kind}; a file is needed")
    return path


@contextlib.contextmanager
def bounded(limit: int, most: int) -> Iterator[None]:
    """Hold this process and those it starts to at most this much of ``resource.RLIMIT_…``."""
    soft, hard = resource.getrlimit(limit)
    known = [each for each in (most, soft) if each != resource.RLIM_INFINITY]
    resource.setrlimit(limit, (min(known), hard))
    try:
        yield
    finally:
        resource.setrlimit(limit, (soft, hard))


def bounded_memory() -> contextlib.AbstractContextManager[None]:
    """Let what a file of others unpacks to take at most ``MOST_MEMORY`` beyond what is used."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    return bounded(resource.RLIMIT_AS, pages * resource.getpagesize() + MOST_MEMORY)


def read_json(path: Path) -> Any:
    """The content of a JSON file; an EpisodeError if there is none that can be read."""
    regular_file(path)
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise EpisodeError(f"{path}: cannot be read ({problem.strerror})") from None
    except (ValueError, RecursionError) as problem:
        raise EpisodeError(f"{path}: not valid JSON ({problem})") from None


def file_hash(path: Path) -> str:
    """SHA-256 of a file; an EpisodeError if it cannot be read."""
    digest = hashlib.sha256()
    regular_file(path)
    try:
        with open(path, "rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    except OSError as problem:
        raise EpisodeError(f"{path}: cannot be read ({problem.strerror})") from None
    return digest.hexdigest()


def write_all(fd: int, data: bytes) -> None:
    """Write all bytes to a file descriptor."""
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]


def sync_folder(folder: Path) -> None:
    """Make a rename in a folder durable."""
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
