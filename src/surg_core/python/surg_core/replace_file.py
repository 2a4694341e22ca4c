"""Writes a calibration file so that there is never a moment without a whole, checked one."""

from __future__ import annotations

import math
import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Callable

import numpy as np
import numpy.typing as npt
import yaml


def replace_file(path: Path, text: str, load: Callable[[Path], object]) -> None:
    """Write beside, read back, rename. The old file stays as ``<name>.previous``.

    Args:
        path: What to replace; its folder must exist.
        text: The new content.
        load: Reads and checks the new file. If it raises, nothing is replaced.

    Raises:
        OSError: The file cannot be written.
    """
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".yaml", dir=path.parent)
    fresh = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        load(fresh)
        fresh.chmod(0o644)
        if path.exists():
            previous = path.with_name(path.name + ".previous")
            kept = fresh.with_suffix(".previous")
            kept.write_bytes(path.read_bytes())
            kept.replace(previous)
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def one_line(text: str) -> str:
    """The text without line breaks, so that it cannot leave its comment or its key."""
    return " ".join(text.split())


def yaml_text(text: str) -> str:
    """A text as a value in YAML, on one line.

    It is quoted unless it is a plain name or path: readers of YAML 1.1 and 1.2 differ in what is a
    number.
    """
    style = None if re.fullmatch(r"(\.\.?/)*[A-Za-z_][\w./ -]*", text, re.ASCII) else '"'
    written = yaml.safe_dump(text, default_style=style, width=math.inf, allow_unicode=True)
    return written.removesuffix("\n").removesuffix("\n...")


def fixed_decimals(values: npt.ArrayLike) -> str:
    """A YAML list with 12 decimals: 1e-12 m or rad. Adding 0.0 turns -0.0 into 0.0."""
    numbers = np.asarray(values, dtype=np.float64).ravel()
    return "[" + ", ".join(f"{round(float(value), 12) + 0.0:.12f}" for value in numbers) + "]"


def exact_number(value: float) -> str:
    """The shortest decimals that give the same bits.

    Always with a dot: readers of YAML 1.1 take ``1e-05`` for a text.
    """
    text = repr(float(value) + 0.0)
    return text if "." in text else text.replace("e", ".0e")


def exact_numbers(values: npt.ArrayLike) -> str:
    """A YAML list of :func:`exact_number`."""
    numbers = np.asarray(values, dtype=np.float64).ravel()
    return "[" + ", ".join(exact_number(value) for value in numbers) + "]"


def exact_rows(values: Sequence[Sequence[float]] | npt.NDArray[np.float64]) -> str:
    """A YAML list over several lines, one for each row of a matrix."""
    rows = [exact_numbers(row)[1:-1] for row in values]
    return "[\n" + ",\n".join(f"  {row}" for row in rows) + "\n]"
