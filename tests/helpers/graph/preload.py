"""Libraries that tests preload into nodes, compiled from the sources beside this file."""

from __future__ import annotations

import functools
import subprocess
import tempfile
from pathlib import Path


@functools.cache
def library(name: str) -> str:
    """The library of ``<name>.cpp``, built once per test process."""
    source = Path(__file__).with_name(f"{name}.cpp")
    path = Path(tempfile.mkdtemp(prefix=f"{name}_")) / f"lib{name}.so"
    subprocess.run(
        ["c++", "-std=c++17", "-O1", "-shared", "-fPIC", str(source), "-o", str(path), "-ldl"],
        check=True,
    )
    return str(path)
