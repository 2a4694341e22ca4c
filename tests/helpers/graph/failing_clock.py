"""An exception in a node's control loop: a library that tests preload into it."""

from __future__ import annotations

import functools
import subprocess
import tempfile
from pathlib import Path

SOURCE = Path(__file__).with_name("failing_clock.cpp")


@functools.cache
def library() -> str:
    """The compiled library, built once per test process."""
    path = Path(tempfile.mkdtemp(prefix="failing_clock_")) / "libfailing_clock.so"
    subprocess.run(
        ["c++", "-std=c++17", "-O1", "-shared", "-fPIC", str(SOURCE), "-o", str(path), "-ldl"],
        check=True,
    )
    return str(path)


def environment(trigger: Path) -> dict[str, str]:
    """Environment in which a control loop throws as soon as a file exists.

    Args:
        trigger: The file.
    """
    return {"LD_PRELOAD": library(), "FAILING_CLOCK": str(trigger)}
