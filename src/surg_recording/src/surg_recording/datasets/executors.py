"""Runs the jobs of an export: in this process, a pool of processes, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from surg_recording import job_pool
from surg_recording.datasets.conversion import ConversionJob, ConversionResult, convert
from surg_recording.datasets.export_report import ExportError
from surg_recording.datasets.options import ExportOptions

Done = Callable[[ConversionResult], None]


def run(jobs: Sequence[ConversionJob], options: ExportOptions, done: Done) -> None:
    """Do the jobs in any order, ``done`` with each; an ExportError if the executor is missing."""
    by_key = {f"export-{job.key}": job for job in jobs}

    def lost(key: str, why: str) -> None:
        job = by_key[key]
        done(ConversionResult(job.folder, job.key, f"{job.folder}: {why}"))

    executor = job_pool.Executor(options.executor, options.workers, options.scheduler)
    callbacks = job_pool.JobCallbacks[ConversionResult](lambda _, result: done(result), lost)
    try:
        job_pool.run(convert, by_key, executor, callbacks)
    except job_pool.NoExecutor as problem:
        raise ExportError(str(problem)) from None
