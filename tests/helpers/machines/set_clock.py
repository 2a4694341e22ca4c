"""A wall clock of some processes that a test can set (`set_clock.c`); the steady one goes on."""

from __future__ import annotations

import os
import struct
import subprocess
from pathlib import Path

SOURCE = Path(__file__).with_suffix(".c")


class SetClock:
    """The clock of every process that is started with ``env``.

    Args:
        folder: For the library and the file that the processes look into.
    """

    def __init__(self, folder: Path) -> None:
        library, self._file = folder / "set_clock.so", folder / "set_clock"
        argv = ["cc", "-shared", "-fPIC", "-O2", "-Wall", "-Werror", "-o", str(library)]
        subprocess.run([*argv, str(SOURCE)], check=True)
        self._file.write_bytes(bytes(8))
        self.env = {"LD_PRELOAD": str(library), "SURG_SET_CLOCK": str(self._file)}

    def set(self, moved_ns: int) -> None:
        """Let the wall clock be so far from the machine's, in one step and at once [ns]."""
        file = os.open(self._file, os.O_WRONLY)
        try:
            os.pwrite(file, struct.pack("=q", moved_ns), 0)
        finally:
            os.close(file)
