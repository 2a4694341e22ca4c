"""Which tests one pytest-xdist worker must run, with ``--dist loadgroup``.

Tests that drive graphs in real time share one group: two such graphs at once would take each
other's cores. That group comes first, so xdist gives it to the first worker that is ready. A worker
that begins with another group has a lower priority from then on. The rest of every file is a group
of its own: its fixtures are made once.

A test in real time gets a higher priority where the system grants it, and so do the processes that
it starts: other programs of the machine then cost it little. Elsewhere the other workers step back.
Where Linux schedules by session each worker leads one of its own. Without workers the session that
the tests were started from is preferred while a test in real time runs: one of its own would lose
the terminal and its Ctrl-C.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from surg_cli.graph import processes

REAL_TIME = "real-time"
GRAPH = "graph-"
"""Begins the group of a file whose tests drive graphs, but not in real time."""
FOLDERS = ("ros", "e2e", "faults")
"""Folders of tests that drive graphs, in real time unless file or test is marked `untimed`."""
NICE = 5
"""Added to the niceness of the others where none may be preferred; more would starve them."""
PREFERRED = -10
"""Niceness of a test in real time."""
_began: list[str] = []  # the group that this worker began with


@contextlib.contextmanager
def priority(item: pytest.Item, tests: Path) -> Iterator[None]:
    """The priority of this process while a test runs; a worker's is set by its first test.

    Args:
        item: The test.
        tests: Root folder of all tests.
    """
    if hasattr(item.config, "workerinput"):
        _begin(item)
    elif in_real_time(item, tests):
        with _preferred_session():
            yield
        return
    yield


def _begin(item: pytest.Item) -> None:
    if _began:
        return
    _began.append(group(item))
    if _began[0] == REAL_TIME:
        _raise()
    else:
        _step_back()
    with contextlib.suppress(OSError):
        os.setsid()  # what else runs in the old session has no part in the priority
        processes.keep_niceness(os.getpid())


@contextlib.contextmanager
def _preferred_session() -> Iterator[None]:
    session, niceness = Path(f"/proc/{os.getsid(0)}/autogroup"), os.nice(0)
    said = session.read_text("ascii") if session.exists() else ""
    _raise()
    processes.keep_niceness(os.getsid(0))
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
        with contextlib.suppress(OSError):  # such as "/autogroup-2048 nice 0"
            session.write_text(said.rpartition(" ")[2], "ascii")


def _raise() -> bool:
    """Whether the system grants a higher priority."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, PREFERRED)
    except OSError:
        return False
    return True


def _step_back() -> None:
    niceness = os.nice(0)
    os.setpriority(os.PRIO_PROCESS, 0, niceness if _raise() else niceness + NICE)


def in_real_time(item: pytest.Item, tests: Path) -> bool:
    """Whether a test below the folder drives graphs in real time, or measures time (`timed`)."""
    if item.get_closest_marker("timed") is not None:
        return True
    return drives_graph(item, tests) and item.get_closest_marker("untimed") is None


def drives_graph(item: pytest.Item, tests: Path) -> bool:
    """Whether a test below the folder starts processes and waits for them."""
    return item.path.is_relative_to(tests) and item.path.relative_to(tests).parts[0] in FOLDERS


def assign(config: pytest.Config, items: list[pytest.Item], tests: Path) -> None:
    """Mark every test with its group, and put the group in real time first.

    Args:
        config: Without an xdist worker behind it, nothing changes.
        items: The collected tests.
        tests: Root folder of all tests.
    """
    if not hasattr(config, "workerinput"):
        return
    for item in items:
        name = GRAPH + item.path.stem if drives_graph(item, tests) else item.path.stem
        name = REAL_TIME if in_real_time(item, tests) else name
        item.add_marker(pytest.mark.xdist_group(name))
    items.sort(key=lambda item: group(item) != REAL_TIME)


def group(item: pytest.Item) -> str:
    """Group of a test, empty without one."""
    mark = item.get_closest_marker("xdist_group")
    return "" if mark is None else str(mark.args[0])
