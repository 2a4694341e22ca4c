"""Other programs that want the same processors."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator

LOAD = int(os.environ.get("SURG_STORM_LOAD", "8"))
"""Programs that never rest, beside the system; fewer where others load the machine already."""


@contextlib.contextmanager
def busy(programs: int = LOAD) -> Iterator[None]:
    """Run programs that never rest."""
    load = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(programs)]
    try:
        yield
    finally:
        for program in load:
            program.kill()
            program.wait()
