"""Finds a cell by name, in a checkout or in an installed package, or by path."""

from __future__ import annotations

from pathlib import Path

_HERE = Path(__file__).resolve().parents[1]


def folders() -> list[Path]:
    """Where cells with a name may be: beside the sources, and in the installed package."""
    return [root / "cells" for root in (*_HERE.parents[3:4], _HERE / "data") if root.is_dir()]


def find(name_or_path: str | Path) -> Path:
    """The folder of a cell.

    Args:
        name_or_path: A bundled cell's name, a cell's folder, or its cell.yaml.

    Raises:
        ValueError: There is none; lists the bundled ones.
    """
    path = Path(name_or_path)
    if (path / "cell.yaml").is_file() or path.is_file():
        return path
    found = {cell.parent.name: cell.parent for f in folders() for cell in f.glob("*/cell.yaml")}
    if str(name_or_path) in found:
        return found[str(name_or_path)]
    raise ValueError(
        f"no cell '{name_or_path}': there are {', '.join(sorted(found)) or 'none'}, or the path of "
        "a folder with a cell.yaml"
    )
