"""Which tests one pytest-xdist worker must run, with ``--dist loadgroup``.

Tests that drive graphs in real time share one group: two such graphs at once would take each
other's cores. That group comes first, so xdist gives it to the first worker that is ready. A worker
that begins with another group runs at a lower priority from then on. Every other file is a group of
its own: its fixtures are made once.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REAL_TIME = "real-time"
FOLDERS = ("ros", "e2e", "faults")
"""Folders of tests that drive graphs, in real time unless the file is marked `untimed`."""
NICE = 10
"""Added to the niceness of the other workers: a graph in real time must not wait for a core."""
_began: list[str] = []  # the group that this worker began with


def begin(item: pytest.Item) -> None:
    """Lower the priority of this process, if its first test is not one in real time."""
    if _began or not hasattr(item.config, "workerinput"):
        return
    _began.append(group(item))
    if _began[0] != REAL_TIME:
        os.nice(NICE)


def assign(config: pytest.Config, items: list[pytest.Item], tests: Path) -> None:
    """Mark every test with its group, and put the group in real time first.

    Args:
        config: Without an xdist worker behind it, nothing changes.
        items: The collected tests.
        tests: Root folder of all tests.
    """
    if not hasattr(config, "workerinput"):
        return
    timed = {item.path for item in items if item.get_closest_marker("untimed") is None}
    for item in items:
        in_real_time = item.path in timed and item.path.relative_to(tests).parts[0] in FOLDERS
        item.add_marker(pytest.mark.xdist_group(REAL_TIME if in_real_time else item.path.stem))
    items.sort(key=lambda item: group(item) != REAL_TIME)


def group(item: pytest.Item) -> str:
    """Group of a test, empty without one."""
    mark = item.get_closest_marker("xdist_group")
    return "" if mark is None else str(mark.args[0])
