"""Keeps the views of a calibration beside its result, so that it can be repeated."""

from __future__ import annotations

import shutil
from pathlib import Path

BESIDE = ("views.csv", "board.yaml")


def keep_views(calibration: Path, step: str, source: Path) -> Path:
    """Copy a folder of views to ``calibration/views/<step>``; the old one stays as ``.previous``.

    Args:
        calibration: The cell's folder of calibrations.
        step: Such as ``stereo``.
        source: Folder of views; pictures, table and board are copied, nothing else.

    Raises:
        OSError: A file cannot be read or written; what was kept before is untouched.
    """
    kept = calibration / "views" / step
    if kept.exists() and kept.samefile(source):
        return kept
    fresh = kept.with_name(f".{step}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    for file in sorted(source.iterdir()):
        if file.name in BESIDE or (file.suffix == ".png" and file.is_file()):
            shutil.copyfile(file, fresh / file.name)
    board = calibration / "board.yaml"
    if not (fresh / board.name).exists() and board.is_file():
        shutil.copyfile(board, fresh / board.name)
    if kept.exists():
        previous = kept.with_name(f"{step}.previous")
        shutil.rmtree(previous, ignore_errors=True)
        kept.rename(previous)
    fresh.rename(kept)
    return kept
