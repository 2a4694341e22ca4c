"""Memory of a process and of all that it starts."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path

PERIOD_S = 0.1
"""Between two looks [s]."""
PAGE_MIB = os.sysconf("SC_PAGE_SIZE") / 2**20


class Peak:
    """Largest resident memory seen, shared libraries included [MiB].

    Attributes:
        own: Of the process itself.
        child: Of the largest process that it started.
        total: Of all together at one time.
    """

    own = child = total = 0.0


@contextlib.contextmanager
def watched(pid: int) -> Iterator[Peak]:
    """Look at a process and its descendants until the block ends."""
    peak, over = Peak(), threading.Event()

    def watch() -> None:
        while not over.wait(PERIOD_S):
            own = _resident(pid)
            children = [_resident(each) for each in _started_by(pid)]
            peak.own = max(peak.own, own)
            peak.child = max([peak.child, *children])
            peak.total = max(peak.total, own + sum(children))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield peak
    finally:
        over.set()
        thread.join()


def _started_by(pid: int) -> list[int]:
    """The children of a process, and theirs."""
    parents: dict[int, list[int]] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # gone
            parent = int(path.read_text().rpartition(")")[2].split()[1])
            parents.setdefault(parent, []).append(int(path.parent.name))
    found = list(parents.get(pid, ()))
    for each in found:
        found += parents.get(each, ())
    return found


def _resident(pid: int) -> float:
    """Memory of a process [MiB]; 0 where it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE_MIB
    except OSError:
        return 0.0
