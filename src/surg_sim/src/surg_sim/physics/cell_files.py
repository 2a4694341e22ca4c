"""Finds a cell by name, in a checkout or in an installed package, or by path."""

from __future__ import annotations

from pathlib import Path

_HERE = Path(__file__).resolve().parents[1]


def folders() -> list[Path]:
    """Where cells with a name may be: beside the sources, and in the installed package."""
    return [root / "cells" for root in (*_HERE.parents[3:4], _HERE / "data") if root.is_dir()]


def find(name_or_path: str | Path) -> Path:
    """The folder of a bundled cell by its name, of a cell's folder, or of its cell.yaml.

    Raises:
        ValueError: There is none; lists the bundled ones.
    """
    path = Path(name_or_path)
    if (path / "cell.yaml").is_file() or path.is_file():
        return path
    cells = (cell for folder in folders() for cell in folder.glob("*/cell.yaml"))
    bundled = {cell.parent.name: cell.parent for cell in cells}
    if str(name_or_path) in bundled:
        return bundled[str(name_or_path)]
    raise ValueError(
        f"no cell '{name_or_path}': there are {', '.join(sorted(bundled)) or 'none'}, or the path "
        "of a folder with a cell.yaml"
    )
