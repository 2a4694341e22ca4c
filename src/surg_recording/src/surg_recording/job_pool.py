"""Runs many independent jobs: in this process, in a pool of processes, or on a Dask cluster.

Jobs must be idempotent. A worker that dies then only costs time: a broken pool is replaced, and
Dask gives the job to another worker. Each job ends once, in the hands of the caller.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import ctypes
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

J = TypeVar("J")
R = TypeVar("R")

EXECUTORS = ("process", "serial", "dask")

DASK_HINT = (
    "the executor dask needs the package distributed (Debian: python3-distributed; pip:"
    " 'surg_recording[dask]'); processes need nothing"
)
CONNECT_S = 20
"""Longest wait for a scheduler [s]."""

_RETRIES = 10
"""Workers that may die under one Dask task before it is given up."""
_M_MMAP_THRESHOLD = -3
"""Parameter of mallopt(3): larger blocks are mapped, and unmapped when they are freed."""
_PR_SET_PDEATHSIG = 1
"""Option of prctl(2): the signal that this process gets when its parent dies."""


class NoExecutor(RuntimeError):
    """The executor is not there; the message says why, and what to do."""


@dataclass(frozen=True)
class Executor:
    """Where jobs run."""

    executor: str = "process"  # of ``EXECUTORS``
    workers: int | None = None  # processes; None: one for each core
    scheduler: str | None = None  # address of a Dask scheduler; None: a cluster of its own

    def workers_for(self, jobs: int) -> int:
        """Number of processes worth starting for so many jobs."""
        return max(1, min(self.workers or len(os.sched_getaffinity(0)), jobs))


@dataclass(frozen=True)
class JobCallbacks(Generic[R]):
    """Who is told how a job ended; each job ends once, in any order."""

    done: Callable[[str, R], None]
    """Gets key and result."""
    lost: Callable[[str, str], None]
    """Gets key and reason of a job that has no result: it killed its process, or Dask gave it up.

    In this process and in a pool, an exception of a job is raised instead.
    """


def run(
    function: Callable[[J], R], jobs: Mapping[str, J], place: Executor, ends: JobCallbacks[R]
) -> None:
    """Do all jobs.

    Args:
        function: Does one. In other processes it is imported by name; so it must not be defined
            in ``__main__``.
        jobs: What the function gets, by key. On one Dask scheduler a key stands for one job.
        place: Where.
        ends: Who is told.

    Raises:
        NoExecutor: Dask is not installed, or no scheduler answers.
    """
    if not jobs:
        return
    if place.executor == "serial":
        for key, job in jobs.items():
            ends.done(key, function(job))
    elif place.executor == "dask":
        _dask(function, jobs, place, ends)
    else:
        _processes(function, jobs, place, ends)


# --- a pool of processes ------------------------------------------------------------------------


def _processes(
    function: Callable[[J], R], jobs: Mapping[str, J], place: Executor, ends: JobCallbacks[R]
) -> None:
    """A pool; when one of its processes dies, the jobs in progress are repeated one by one."""
    left = _pool(function, jobs, place.workers_for(len(jobs)), ends)
    for key, job in left.items():
        if _pool(function, {key: job}, 1, ends):  # alone in its pool: it kills the process itself
            ends.lost(key, "the process that worked on it died")


def _pool(
    function: Callable[[J], R], jobs: Mapping[str, J], workers: int, ends: JobCallbacks[R]
) -> dict[str, J]:
    """Run jobs in one pool; returns those without an end because a process died."""
    context = multiprocessing.get_context("spawn")  # forks of a process with threads may hang
    pool = concurrent.futures.ProcessPoolExecutor(workers, context, _begin_worker)
    waiting = {pool.submit(function, job): key for key, job in jobs.items()}
    left: dict[str, J] = {}
    try:
        for future in concurrent.futures.as_completed(waiting):
            key = waiting[future]
            try:
                result = future.result()
            except BrokenProcessPool:
                left[key] = jobs[key]
            else:
                ends.done(key, result)
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
    return left


def _begin_worker() -> None:
    """Leave signals to the parent, end with it, and give freed arrays back to the system.

    Ctrl-C reaches the whole terminal group; the parent ends its workers itself, unless it is
    killed. glibc keeps freed blocks of up to 32 MiB, so that a worker would stay as large as its
    largest job made it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(AttributeError, OSError):  # not Linux, or not glibc
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, 1 << 16)


# --- Dask ---------------------------------------------------------------------------------------


def _dask(
    function: Callable[[J], R], jobs: Mapping[str, J], place: Executor, ends: JobCallbacks[R]
) -> None:
    """An own Dask cluster, or the scheduler at an address (with the same disk and software)."""
    try:
        import distributed
    except ImportError as problem:
        raise NoExecutor(f"{DASK_HINT} ({problem})") from None

    with _client(place, len(jobs)) as client:
        futures = [client.submit(function, job, key=key) for key, job in jobs.items()]
        # The loop of this client fetches the results: another client's would refuse them.
        ended = distributed.as_completed(
            futures, loop=client.loop, with_results=True, raise_errors=False
        )
        for future, result in ended:
            if future.status == "finished":
                ends.done(future.key, result)
            else:
                ends.lost(future.key, str(result[1] if isinstance(result, tuple) else result))


@contextlib.contextmanager
def _client(place: Executor, jobs: int) -> Iterator[Any]:
    """A client of the scheduler, which is closed at the end with a cluster of its own.

    Raises:
        NoExecutor: No scheduler answers.
    """
    import dask
    import distributed

    settings = {
        "distributed.scheduler.allowed-failures": _RETRIES,
        "distributed.worker.daemon": True,
        "distributed.logging.distributed": "critical",
    }
    with dask.config.set(settings), contextlib.ExitStack() as open_ones:
        try:
            address: Any = place.scheduler
            if address is None:
                address = distributed.LocalCluster(
                    n_workers=place.workers_for(jobs),
                    threads_per_worker=1,
                    dashboard_address=None,
                    silence_logs="CRITICAL",
                    host="127.0.0.1",
                )
                open_ones.callback(address.close)
            client = distributed.Client(address, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError) as problem:
            raise NoExecutor(
                f"scheduler {place.scheduler}: no Dask scheduler answers there ({problem})"
            ) from None
        open_ones.callback(client.close)
        yield client
