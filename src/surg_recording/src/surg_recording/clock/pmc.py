"""Queries a running PTP daemon through linuxptp's ``pmc``, with GET only."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from surg_recording.clock import clock_sync
from surg_recording.clock.clock_sync import ClockStatus

ANSWER = 2.0
"""Longest wait for an answer [s]."""
FOLDERS = ("/usr/sbin", "/sbin", "/usr/local/sbin")
"""Folders of linuxptp on Debian; not on every user's path."""


def program(name: str) -> str | None:
    """Path of one of linuxptp's programs; None if it is not installed."""
    path = os.pathsep.join([os.environ.get("PATH", os.defpath), *FOLDERS])
    return shutil.which(name, path=path)


def ask(socket: Path | str = clock_sync.SOCKET, timeout: float = ANSWER) -> ClockStatus:
    """Query the daemon at ``socket`` (its ``uds_address``) once; waits at most ``timeout`` [s].

    Never raises: errors are in ``problem``.
    """
    executable = program("pmc")
    if executable is None:
        return ClockStatus(problem="pmc is not installed: apt install linuxptp")
    if not Path(socket).exists():
        return ClockStatus(
            problem=f"no PTP daemon at {socket}: start `sudo ./surg ptp master` or `slave`"
        )
    if not os.access(socket, os.W_OK):
        return ClockStatus(
            problem=f"{socket}: no permission to ask; the daemon lets the user ask who started it"
            " with sudo, and root"
        )
    questions = [f"GET {name}" for name in clock_sync.QUESTIONS]
    with tempfile.TemporaryDirectory(prefix="pmc_") as folder:
        own = str(Path(folder) / "socket")
        argv = [executable, "-u", "-b", "0", "-s", str(socket), "-i", own, *questions]
        try:
            done = subprocess.run(
                argv,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=timeout,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return ClockStatus(problem=f"the PTP daemon did not answer within {timeout:g} s")
        except OSError as problem:
            return ClockStatus(problem=f"{executable}: {problem.strerror}")
    status = clock_sync.parse(done.stdout)
    if status.problem and done.stderr.strip():
        return ClockStatus(problem=f"{status.problem} (pmc: {done.stderr.strip()[:160]})")
    return status
