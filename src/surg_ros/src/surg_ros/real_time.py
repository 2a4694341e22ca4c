"""A real-time priority for a node that has begun."""

from __future__ import annotations

import contextlib
import os

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
