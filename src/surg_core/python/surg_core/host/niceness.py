"""Niceness that counts: of a process, and of its session."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def give_way(by: int, process: int = 0) -> None:
    """Let others go first: add to the niceness of a process, 0: of this one.

    Linux may schedule by session (autogroup). A niceness then counts only among the processes of a
    session, and a new session begins at 0, so a session is given it together with its leader.
    """
    pid = process or os.getpid()
    niceness = min(os.getpriority(os.PRIO_PROCESS, 0) + by, 19)
    with contextlib.suppress(OSError):  # no such scheduling, or it has ended
        os.setpriority(os.PRIO_PROCESS, pid, niceness)
        if os.getsid(pid) == pid:
            Path(f"/proc/{pid}/autogroup").write_text(str(niceness), "ascii")
