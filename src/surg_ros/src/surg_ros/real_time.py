"""Who goes first: a real-time priority for a node that has begun, niceness for what can wait."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

HIGHEST = 78
"""Of a driver; the controller has 79 and 80."""


def prefer(priority: int) -> None:
    """Ask for a priority of SCHED_FIFO for all threads of this process; 0: none.

    Call it behind the imports: a second of computing at a real-time priority keeps the kernel's
    own workers waiting, and with them every serial line.
    """
    for thread in os.listdir("/proc/self/task") if priority else ():
        with contextlib.suppress(OSError):  # a simulated bench, no permission, or it has ended
            os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(priority))


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
