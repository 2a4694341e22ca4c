"""Exports recordings as a dataset: inspect, convert, assemble, read back.

A recording is converted completely or refused with a reason; the others continue. The dataset is
renamed to its final name in one step, after it has been read back. Until then the converted
recordings (parts) are in ``<out>.parts``, so that an interrupted export can continue.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_core.plugins import source_file
from surg_recording import job_pool
from surg_recording.datasets import export_plan, inspection, schema
from surg_recording.datasets.conversion import (
    ConversionJob,
    ConversionResult,
    convert,
    remove_unfinished,
)
from surg_recording.datasets.dataset import Dataset, Part
from surg_recording.datasets.export_manifest import is_up_to_date, write_manifest
from surg_recording.datasets.export_report import ExportError, Progress, Report
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.frames.sampling import sample
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import Feature
from surg_recording.datasets.splits import arrange
from surg_recording.recording_errors import EpisodeError, words_of

UNFINISHED = ".unfinished"
"""Suffix of a dataset that is being assembled."""


def export(
    exporter: Exporter,
    episodes: Sequence[Path],
    out: Path,
    options: ExportOptions,
    progress: Progress,
) -> Report:
    """Export recordings; see ``Exporter.write``."""
    exporter.require()
    plan = export_plan.make(exporter, episodes, options, progress)
    report = Report(exporter.name, out, refused=dict(plan.refused))
    if options.where is not None:
        report.facts["not selected"] = plan.unselected
    if not plan.candidates:
        _nothing_left(report)
    parts = out.with_name(out.name + ".parts")
    if out.exists() and is_up_to_date(out, exporter, plan.keys, options, report):
        return report
    parts.mkdir(parents=True, exist_ok=True)
    remove_unfinished(parts)
    # Other processes load the exporter by its file, or by name.
    locator = source_file(exporter) or exporter.name
    jobs = [
        ConversionJob(c.folder, locator, options, c.layout, key, parts)
        for c, key in zip(plan.candidates, plan.keys, strict=True)
    ]
    _convert(jobs, options, report, progress)
    if options.shard is not None:
        report.facts["shard"] = "{}/{}".format(*options.shard)
        report.recordings = sum(1 for job in jobs if (parts / job.key).exists())
        return report
    made = [parts / job.key for job in jobs if (parts / job.key).exists()]
    finished = [part for folder in made for part in Part.load_all(folder)]
    for part in finished:
        if part.features != finished[0].features:
            report.refused[part.source] = _unlike(finished[0].features, part.features, part.source)
    finished = [part for part in finished if part.features == finished[0].features]
    if not finished:
        _nothing_left(report)
    progress(None, "assembling")
    sources = {part.source for part in finished}
    taken = [c for c in plan.candidates if str(c.folder) in sources]
    mixed = inspection.mixture(taken)
    if mixed:
        report.facts["mixed"] = mixed
    dataset = arrange(out.name, finished, inspection.common(taken), options)
    _assemble(exporter, dataset, out, options, report)
    if not report.errors and not options.keep_parts:
        shutil.rmtree(parts, ignore_errors=True)
    return report


def dry_run(
    exporter: Exporter, episodes: Sequence[Path], options: ExportOptions, progress: Progress
) -> Report:
    """Check everything but pictures, and report; an ExportError if nothing can be exported."""
    exporter.require()
    plan = export_plan.make(exporter, episodes, options, progress)
    report = Report(exporter.name, Path(), refused=dict(plan.refused))
    if options.where is not None:
        report.facts["not selected"] = plan.unselected
    kinds: dict[str, int] = {}
    first: tuple[Feature, ...] | None = None
    mixed = inspection.mixture(plan.candidates)
    if mixed:
        report.facts["mixed"] = mixed
    for number, candidate in enumerate(plan.candidates):
        progress(number / len(plan.candidates), f"reading {candidate.folder.name}")
        try:
            sampled = sample(candidate, options)
        except Exception as problem:  # one recording, not the export
            report.refused[str(candidate.folder)] = words_of(problem, candidate.folder)
            continue
        first = first or sampled.features
        if sampled.features != first:
            report.refused[str(candidate.folder)] = _unlike(
                first, sampled.features, str(candidate.folder)
            )
            continue
        pieces = len(sampled.pieces(exporter.longest_s))
        report.recordings += pieces
        report.frames += sampled.grid.frames
        if pieces > 1:
            report.warnings.append(split_words(candidate.folder, pieces, exporter))
        report.warnings += _told(str(candidate.folder), sampled.notes)
        kinds[candidate.kind] = kinds.get(candidate.kind, 0) + 1
        report.facts.setdefault("features", {f.name: list(f.shape) for f in sampled.features})
    report.facts["kinds"] = kinds
    return report


def _convert(
    jobs: list[ConversionJob], options: ExportOptions, report: Report, progress: Progress
) -> None:
    """Do the remaining jobs; failures go to ``refused``. ExportError if there is no executor."""
    if options.shard is not None:
        index, count = options.shard
        jobs[:] = jobs[index::count]
    todo = [job for job in jobs if not (job.parts / job.key).exists()]
    done = 0

    def note(outcome: ConversionResult) -> None:
        nonlocal done
        done += 1
        if outcome.problem is not None:
            report.refused[str(outcome.folder)] = outcome.problem
        report.made += outcome.made
        progress(0.1 + 0.85 * done / len(todo), f"{done} of {len(todo)} recordings converted")

    progress(0.1, f"0 of {len(todo)} recordings converted")
    by_key = {f"export-{job.key}": job for job in todo}

    def lost(key: str, why: str) -> None:
        job = by_key[key]
        note(ConversionResult(job.folder, job.key, f"{job.folder}: {why}"))

    place = job_pool.Executor(options.executor, options.workers, options.scheduler)
    callbacks = job_pool.JobCallbacks[ConversionResult](lambda _, result: note(result), lost)
    try:
        job_pool.run(convert, by_key, place, callbacks)
    except job_pool.NoExecutor as problem:
        raise ExportError(str(problem)) from None


def _assemble(
    exporter: Exporter, dataset: Dataset, out: Path, options: ExportOptions, report: Report
) -> None:
    """Assemble under a temporary name, validate, and rename."""
    staging = out.with_name(out.name + UNFINISHED)
    shutil.rmtree(staging, ignore_errors=True)
    staging.mkdir(parents=True)
    try:
        exporter.assemble(dataset, staging)
        validated = exporter.validate(staging)
        report.recordings, report.frames = validated.recordings, validated.frames
        report.errors += validated.errors
        report.warnings += validated.warnings
        for part in dataset.parts:
            if part.piece and part.piece.startswith("1 of "):
                pieces = int(part.piece.rpartition(" ")[2])
                report.warnings.append(split_words(Path(part.source), pieces, exporter))
            if not part.piece or part.piece.startswith("1 of "):
                report.warnings += _told(part.source, part.notes)
        report.facts.update(validated.facts)
        if validated.recordings != len(dataset.parts) or validated.frames != dataset.frames:
            report.errors.append(
                f"read back {validated.recordings} recordings with {validated.frames} frames;"
                f" {len(dataset.parts)} with {dataset.frames} were written"
            )
        if report.errors:
            return
        write_manifest(exporter, dataset, staging, report)
        old = out.with_name(out.name + ".replaced")
        if out.exists():
            shutil.rmtree(old, ignore_errors=True)
            os.rename(out, old)
        os.rename(staging, out)
        shutil.rmtree(old, ignore_errors=True)
    except EpisodeError as problem:
        report.errors.append(str(problem))
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _unlike(first: Sequence[Feature], features: Sequence[Feature], source: str) -> str:
    """Why a recording does not fit the first one."""
    return (
        f"{source}: its features are not those of the first recording"
        f" ({schema.difference(first, features)}); --columns without this one, or --drop, leaves it"
        " out"
    )


def _told(source: str, notes: Mapping[str, Any]) -> list[str]:
    """What the report says of an exported recording."""
    told = [f"{source}: {notes['segment']} is exported"] if "segment" in notes else []
    return told + [f"{source}: {remark}" for remark in notes.get("remarks", ())]


def split_words(source: Path, pieces: int, exporter: Exporter) -> str:
    """What the report says of a long recording."""
    return (
        f"{source}: longer than the {exporter.longest_s:g} s that one episode of {exporter.title}"
        f" can hold; it is exported as {pieces} episodes of the same split"
    )


def _nothing_left(report: Report) -> None:
    shown = "\n".join(f"  {reason}" for reason in list(report.refused.values())[:10])
    raise ExportError(f"no recording can be exported:\n{shown}")
