"""Runs the jobs of an export: in this process, a pool of processes, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from surg_recording import job_pool
from surg_recording.datasets.exporter import ExportError
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.parts import Job, Outcome, make

Done = Callable[[Outcome], None]


def run(jobs: Sequence[Job], options: ExportOptions, done: Done) -> None:
    """Do the jobs in any order, ``done`` with each; an ExportError if the executor is missing."""
    by_key = {f"export-{job.key}": job for job in jobs}

    def lost(key: str, why: str) -> None:
        job = by_key[key]
        done(Outcome(job.folder, job.key, f"{job.folder}: {why}"))

    place = job_pool.Executor(options.executor, options.workers, options.scheduler)
    ends = job_pool.JobCallbacks[Outcome](done=lambda _, outcome: done(outcome), lost=lost)
    try:
        job_pool.run(make, by_key, place, ends)
    except job_pool.NoExecutor as problem:
        raise ExportError(str(problem)) from None
