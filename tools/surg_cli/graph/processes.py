"""Child processes that cannot outlive their parent.

Each child leads a session and a process group of its own, and the kernel kills it when its parent
dies (`PR_SET_PDEATHSIG`, set by util-linux' `setpriv`, so no Python runs between fork and exec).
Children are started from the main thread: the death signal follows the thread that forked.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

SETPRIV = "/usr/bin/setpriv"
STAGES = ((signal.SIGINT, 4.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0))
"""How children are ended: signals, and how long each may take [s]."""
PR_SET_CHILD_SUBREAPER = 36


def keep_niceness(session: int, more: int = 0) -> None:
    """Give a session that this process has started, or leads, this process's niceness, or more.

    Linux may schedule by session (autogroup). A niceness then counts only within its session, and a
    new session begins at 0.
    """
    niceness = min(os.getpriority(os.PRIO_PROCESS, 0) + more, 19)
    with contextlib.suppress(OSError):
        Path(f"/proc/{session}/autogroup").write_text(str(niceness), "ascii")


def session_members(session: int) -> list[int]:
    """Ids of the live processes of a session: its leader (whose id it is) and what that started."""
    members = []
    for entry in os.scandir("/proc"):
        if not entry.name.isdigit():
            continue
        fields = _stat_fields(int(entry.name))
        if fields is not None and int(fields[3]) == session and fields[0] not in "ZX":
            members.append(int(entry.name))
    return members


def start_time(pid: int) -> int | None:
    """Start of a process in clock ticks since boot; None: it is gone. With the id it is unique."""
    fields = _stat_fields(pid)
    return None if fields is None or fields[0] in "ZX" else int(fields[19])


def _stat_fields(pid: int) -> list[str] | None:
    """Fields 3 and up of /proc/PID/stat (state, parent, group, session, …), None when gone."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    # The command name stands in parentheses and may hold blanks: split behind it.
    return text.rpartition(")")[2].split()


@dataclass
class Child:
    """One running program; its end ends the run if it is essential."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path
    essential: bool = True

    @property
    def exit_code(self) -> int | None:
        """Exit status, negative for a signal, None while it runs."""
        return self.process.poll()

    def log_tail(self, lines: int = 12) -> str:
        """Return the last lines of its output."""
        try:
            text = self.log.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""
        return "\n".join(text.rstrip().splitlines()[-lines:])

    @property
    def alive(self) -> bool:
        """Whether it, or anything it has started, still runs."""
        return self.exit_code is None or bool(session_members(self.process.pid))

    def send(self, number: signal.Signals) -> None:
        """Signal the child and whatever it has started; nothing happens when all are gone."""
        for pid in session_members(self.process.pid):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, number)


def _all_ended(children: Sequence[Child]) -> bool:
    return not any(child.alive for child in children)


@dataclass
class Supervisor:
    """A set of children that lives and dies together; a context manager.

    ``env`` is given to every child, ``logs`` has a file for each, ``children`` are in the order of
    their start.
    """

    env: dict[str, str]
    logs: Path
    children: list[Child] = field(default_factory=list)

    def __enter__(self) -> Supervisor:
        """Return itself; children are started by `start`."""
        return self

    def start(
        self,
        name: str,
        argv: Sequence[str | Path],
        essential: bool = True,
        extra_env: Mapping[str, str] | None = None,
    ) -> Child:
        """Start a program that dies with its parent; its name names the log file too.

        Raises:
            OSError: The program cannot be started.
        """
        log = self.logs / (name.strip("/").replace("/", "_") + ".log")
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("wb") as stream:
            process = subprocess.Popen(
                (SETPRIV, "--pdeathsig", "KILL", "--", *map(str, argv)),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                env={**self.env, **(extra_env or {})},
                start_new_session=True,
            )
        keep_niceness(process.pid)
        child = Child(name, process, log, essential)
        self.children.append(child)
        return child

    def first_dead(self) -> Child | None:
        """The first essential child that has ended, or None."""
        ended = (c for c in self.children if c.essential and c.exit_code is not None)
        return next(ended, None)

    def stop(self, children: Sequence[Child] | None = None) -> list[str]:
        """End the given children, or all, and what they have started.

        All are waited for together, the last started is asked first. Returns the names of those
        that had to be killed.
        """
        waiting = list(reversed(self.children if children is None else children))
        killed: list[str] = []
        for number, grace in STAGES:
            waiting = [c for c in waiting if c.alive]
            killed = [child.name for child in waiting]
            for child in waiting:
                child.send(number)
            wait_until(functools.partial(_all_ended, waiting), grace)
        return killed

    def __exit__(self, kind: object, value: object, trace: object) -> None:
        """End all; a second Ctrl-C meanwhile changes nothing."""
        with signals_ignored():
            self.stop()


def interrupt_on_signals() -> None:
    """Turn every ending signal into KeyboardInterrupt, so that each way out stops the children."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt(signal.Signals(number).name)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)


@contextlib.contextmanager
def signals_ignored() -> Iterator[None]:
    """Ignore the signals that end a command while something must be finished."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def wait_until(condition: Callable[[], bool], timeout_s: float, period_s: float = 0.02) -> bool:
    """Poll a condition on the steady clock; returns whether it came true in time."""
    deadline = time.monotonic() + timeout_s
    while True:
        if condition():
            return True
        if time.monotonic() >= deadline:
            return False
        time.sleep(period_s)


@contextlib.contextmanager
def orphans_adopted(grace_s: float = 5.0) -> Iterator[None]:
    """Be the parent of orphaned descendants, and end them with the context.

    An orphan is, for example, a video encoder that completes its file; it gets ``grace_s`` to end
    by itself. The context must end without other children: every child counts as adopted.
    """
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        yield
    finally:
        with signals_ignored():
            _end_orphans(grace_s)


def _end_orphans(grace_s: float) -> None:
    """Wait for adopted processes, then kill them."""
    deadline = time.monotonic() + grace_s
    while pids := _children_of(os.getpid()):
        late = time.monotonic() > deadline
        for pid in pids:
            with contextlib.suppress(ProcessLookupError, ChildProcessError):
                if late:
                    os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0 if late else os.WNOHANG)
        time.sleep(0.02)


def _children_of(parent: int) -> list[int]:
    """Ids of the processes, dead ones included, whose parent is `parent`."""
    pids = [int(entry.name) for entry in os.scandir("/proc") if entry.name.isdigit()]
    fields = {pid: _stat_fields(pid) for pid in pids}
    return [pid for pid, each in fields.items() if each is not None and int(each[1]) == parent]
