"""The files of the project, and which of them are product code."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from surg_cli.host import paths

PRODUCT = ("src", "tools", "examples", "benchmarks")
FOLDERS = (*PRODUCT, "tests", "docs", "cells")
MADE = (".pyc", ".pyi")
"""Endings of what a build or a run leaves beside the sources."""


def tracked() -> list[Path]:
    """Files of the project: tracked, or new and not ignored."""
    argv = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    if shutil.which("git"):
        done = subprocess.run(argv, cwd=paths.ROOT, capture_output=True, check=False)
        names = done.stdout.decode().split("\0") if done.returncode == 0 else []
        files = [paths.ROOT / name for name in names if name and (paths.ROOT / name).is_file()]
        if files:
            return files
    found = [file for name in FOLDERS for file in (paths.ROOT / name).rglob("*")]
    return [file for file in found if file.is_file() and file.suffix not in MADE]


def product() -> list[Path]:
    """Files of the product, without its tests."""
    inside = [(file, file.relative_to(paths.ROOT).parts) for file in tracked()]
    return [file for file, parts in inside if parts[0] in PRODUCT and "tests" not in parts]
