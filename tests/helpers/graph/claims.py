"""Several pytests share one list of tests: a file is run by the one that claims it first.

What drives graphs in real time is run by the first of them alone: two such at once would take each
other's cores. It begins with those and then goes through the other files from behind; the others go
through them from the front, and they meet. Each has a ROS master of its own.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

LIVE = ("ros", "e2e", "faults")
"""Folders of tests that drive graphs, in real time where a file's mark does not say `untimed`."""


class Claims:
    """The plugin of one pytest.

    Args:
        folder: Shared by all of them: holds a file for every file that one has claimed.
        first: Whether this is the one for what runs in real time.
        tests: The folder of all tests.
    """

    def __init__(self, folder: Path, first: bool, tests: Path) -> None:
        self._folder, self._first, self._tests = folder, first, tests
        self._mine: dict[Path, bool] = {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Bring the files into this one's order; the tests of a file stay together."""
        files: dict[Path, list[pytest.Item]] = {}
        for item in items:
            files.setdefault(item.path, []).append(item)
        live = [path for path in files if self._is_live(path, files[path])]
        rest = [path for path in files if path not in live]
        order = [*live, *reversed(rest)] if self._first else rest
        items[:] = [item for path in order for item in files[path]]

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> bool | None:
        """Run a test only where its file is claimed."""
        return None if self._is_mine(item.path) else True

    def _is_live(self, path: Path, tests: list[pytest.Item]) -> bool:
        timed = any(test.get_closest_marker("untimed") is None for test in tests)
        return timed and path.relative_to(self._tests).parts[0] in LIVE

    def _is_mine(self, path: Path) -> bool:
        """Whether this one has the file; the first who asks gets it."""
        if path not in self._mine:
            name = "_".join(path.relative_to(self._tests).parts)
            try:
                os.close(os.open(self._folder / name, os.O_CREAT | os.O_EXCL))
                self._mine[path] = True
            except FileExistsError:
                self._mine[path] = False
        return self._mine[path]
