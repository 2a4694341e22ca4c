"""Runs the tests of a Python package on a copy of it until one fails."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

from surg_cli.host import paths

FIRST, REST = 600.0, 1200.0
"""A mutant may hang a test: time for the tests that are named first, and for the others [s]."""


def killer(copy: Path, tests: Sequence[Path], first: tuple[str, ...]) -> str | None:
    """What failed, or None.

    Args:
        copy: Folder with the package; it comes before the tree's own on the path.
        tests: All test files.
        first: Names of those that run first.
    """
    named = [file for file in tests if file.stem in first]
    for batch, timeout in ((named, FIRST), ([f for f in tests if f not in named], REST)):
        if not batch:
            continue
        argv = [str(paths.VENV_PYTHON), "-m", "pytest", "-q", "-x", "-p", "no:xdist"]
        env = {**os.environ, "PYTHONPATH": f"{copy}:{os.environ['PYTHONPATH']}"}
        try:
            done = subprocess.run(
                [*argv, *map(str, batch)],
                cwd=paths.ROOT,
                capture_output=True,
                text=True,
                timeout=timeout,
                env=env,
            )
        except subprocess.TimeoutExpired:
            return f"{batch[0].stem}: does not end"
        if done.returncode != 0:
            found = re.search(r"FAILED \S+?(test_\w+\.py::\S+)", done.stdout)
            return found.group(1) if found else done.stdout[-300:]
    return None
