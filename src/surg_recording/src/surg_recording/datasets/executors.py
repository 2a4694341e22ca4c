"""Runs the jobs of an export: in this process, a pool of processes, or a Dask cluster.

Jobs are idempotent, so a worker that dies only costs time: a broken pool is replaced, and Dask
gives the job to another worker.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import ctypes
import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from surg_recording.datasets.exporter import ExportError
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.parts import Job, Outcome, make

Done = Callable[[Outcome], None]

DASK_HINT = (
    "the executor dask needs the package distributed (Debian: python3-distributed; pip:"
    " 'surg_recording[dask]'); --executor process needs nothing"
)
_RETRIES = 10
"""Workers that may die under one Dask task before it is given up."""

_M_MMAP_THRESHOLD = -3
"""Parameter of mallopt(3): larger blocks are mapped, and unmapped when they are freed."""

CONNECT_S = 20
"""Longest wait for a scheduler [s]."""


def run(jobs: Sequence[Job], options: ExportOptions, done: Done) -> None:
    """Do the jobs in any order, ``done`` with each; an ExportError if the executor is missing."""
    if not jobs:
        return
    if options.executor == "serial":
        for job in jobs:
            done(make(job))
    elif options.executor == "dask":
        _dask(jobs, options, done)
    else:
        _processes(jobs, options, done)


def workers_of(options: ExportOptions, jobs: int) -> int:
    """Number of processes worth starting."""
    return max(1, min(options.workers or len(os.sched_getaffinity(0)), jobs))


def _processes(jobs: Sequence[Job], options: ExportOptions, done: Done) -> None:
    """A pool; when one of its processes dies, the jobs in progress are repeated one by one."""
    left = _pool(list(jobs), workers_of(options, len(jobs)), done)
    for job in left:
        if _pool([job], 1, done):  # alone in its pool: it is this recording that kills the process
            done(Outcome(job.folder, job.key, f"{job.folder}: the process that converted it died"))


def _pool(jobs: list[Job], workers: int, done: Done) -> list[Job]:
    """Run jobs in one pool; returns those without an outcome because a process died."""
    context = multiprocessing.get_context("spawn")  # forks of a process with threads may hang
    pool = concurrent.futures.ProcessPoolExecutor(workers, context, _begin_worker)
    waiting = {pool.submit(make, job): job for job in jobs}
    left: list[Job] = []
    try:
        for future in concurrent.futures.as_completed(waiting):
            try:
                done(future.result())
            except BrokenProcessPool:
                left.append(waiting[future])
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
    return left


def _begin_worker() -> None:
    """Leave signals to the parent, and give freed arrays back to the system.

    Ctrl-C reaches the whole terminal group; the parent ends its workers itself. glibc keeps freed
    blocks of up to 32 MiB, so that a worker would stay as large as its largest recording made it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(AttributeError, OSError):  # not glibc
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, 1 << 16)


def _dask(jobs: Sequence[Job], options: ExportOptions, done: Done) -> None:
    """An own Dask cluster, or the scheduler at an address (with the same disk)."""
    try:
        import distributed
    except ImportError as problem:
        raise ExportError(f"{DASK_HINT} ({problem})") from None
    import dask

    settings = {
        "distributed.scheduler.allowed-failures": _RETRIES,
        "distributed.worker.daemon": True,
        "distributed.logging.distributed": "critical",
    }
    with dask.config.set(settings):
        cluster: Any = None
        try:
            if options.scheduler is None:
                cluster = distributed.LocalCluster(
                    n_workers=workers_of(options, len(jobs)),
                    threads_per_worker=1,
                    dashboard_address=None,
                    silence_logs="CRITICAL",
                    host="127.0.0.1",
                )
            client = distributed.Client(cluster or options.scheduler, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError) as problem:
            raise ExportError(
                f"--scheduler {options.scheduler}: no Dask scheduler answers there ({problem})"
            ) from None
        try:
            by_key = {f"export-{job.key}": job for job in jobs}
            futures = [client.submit(make, job, key=key) for key, job in by_key.items()]
            # The loop of this client fetches the results: another client's would refuse them.
            ended = distributed.as_completed(
                futures, loop=client.loop, with_results=True, raise_errors=False
            )
            for future, result in ended:
                job = by_key[future.key]
                if future.status == "finished":
                    done(result)
                else:
                    why = result[1] if isinstance(result, tuple) else result
                    done(Outcome(job.folder, job.key, f"{job.folder}: {why}"))
        finally:
            client.close()
            if cluster is not None:
                cluster.close()
