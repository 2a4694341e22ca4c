"""Exports recordings as a dataset: inspect, convert, assemble, read back.

A recording is converted completely or refused with a reason; the others continue. The dataset gets
its name in one step, after it has been read back. Until then the converted recordings (parts) are
in ``<out>.parts``, so that an interrupted export can continue.
"""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_core.plugins import source_file
from surg_recording.datasets import executors, inspection
from surg_recording.datasets.exporter import (
    MANIFEST,
    PART,
    Dataset,
    Exporter,
    ExportError,
    Part,
    Progress,
    Report,
)
from surg_recording.datasets.inspection import FAILURE, RECOVERY, SUCCESS, Candidate
from surg_recording.datasets.options import SPLITS, ExportOptions
from surg_recording.datasets.parts import Job, Outcome, file_hash, input_hash, sweep
from surg_recording.datasets.sampling import sample
from surg_recording.episode import episode_reader
from surg_recording.recording_errors import EpisodeError

FORMAT = "surg_export/1"
UNFINISHED = ".unfinished"
"""Suffix of a dataset that is being put together."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What will be exported."""

    candidates: tuple[Candidate, ...]
    keys: tuple[str, ...]
    refused: dict[str, str]


def export(
    exporter: Exporter,
    episodes: Sequence[Path],
    out: Path,
    options: ExportOptions,
    progress: Progress,
    locator: str | None = None,
) -> Report:
    """Export recordings with an exporter; see ``Exporter.write``.

    Args:
        exporter: does it.
        episodes: folders of recordings, or folders that hold some.
        out: the folder to make.
        options: all choices.
        progress: is told how far the work is.
        locator: name or path by which other processes load the exporter; default: its name, or the
            file it comes from.

    Raises:
        ExportError: nothing can be exported at all.
    """
    exporter.require()
    plan = make_plan(exporter, episodes, options, progress)
    report = Report(exporter.name, out, refused=dict(plan.refused))
    if not plan.candidates:
        _nothing_left(report)
    parts = out.with_name(out.name + ".parts")
    if out.exists() and _is_same(out, exporter, plan, options, report):
        return report
    parts.mkdir(parents=True, exist_ok=True)
    sweep(parts)
    jobs = [
        Job(c.folder, locator or _locator(exporter), options, c.layout, key, parts)
        for c, key in zip(plan.candidates, plan.keys, strict=True)
    ]
    _convert(jobs, options, report, progress)
    if options.shard is not None:
        report.facts["shard"] = "{}/{}".format(*options.shard)
        report.recordings = sum(1 for job in jobs if (parts / job.key / PART).exists())
        return report
    finished = [Part.load(parts / job.key) for job in jobs if (parts / job.key / PART).exists()]
    kept = {part.source: part.features for part in finished}
    for part in finished[1:]:
        if part.features != finished[0].features:
            report.refused[part.source] = "its features are not those of the first recording"
            kept.pop(part.source)
    finished = [part for part in finished if part.source in kept]
    if not finished:
        _nothing_left(report)
    progress(None, "putting together")
    dataset = arrange(out.name, finished, plan.candidates[0].layout, options)
    _assemble(exporter, dataset, out, options, report)
    if not report.errors and not options.keep_parts:
        shutil.rmtree(parts, ignore_errors=True)
    return report


def make_plan(
    exporter: Exporter, episodes: Sequence[Path], options: ExportOptions, progress: Progress
) -> Plan:
    """Find the recordings and judge each by its manifest.

    The first good one decides what the export holds; those that hold something else are refused.

    Raises:
        ExportError: there is no recording at all.
    """
    folders, refused = find(episodes)
    candidates: list[Candidate] = []
    keys: dict[str, Path] = {}
    for number, folder in enumerate(folders):
        progress(0.1 * number / len(folders), f"looking at {folder.name}")
        try:
            candidate = inspection.look(folder, options)
            other = candidates[0].layout.difference(candidate.layout) if candidates else None
            if other is not None:
                raise EpisodeError(f"{folder}: {other}; export it with others of its kind")
            key = input_hash(folder, candidate.layout, options, exporter)
        except EpisodeError as problem:
            refused[str(folder)] = str(problem)
            continue
        if key in keys:
            refused[str(folder)] = f"{folder}: the same recording as {keys[key]}"
            continue
        keys[key] = folder
        candidates.append(candidate)
    return Plan(tuple(candidates), tuple(keys), refused)


def find(episodes: Sequence[Path]) -> tuple[list[Path], dict[str, str]]:
    """Folders of recordings in the order given (by name inside a folder), and what is none.

    Raises:
        ExportError: a path does not exist, or nothing was found.
    """
    found: list[Path] = []
    refused: dict[str, str] = {}
    for path in episodes:
        if not path.is_dir():
            raise ExportError(f"{path}: no such folder; name folders of recordings")
        if (path / episode_reader.MANIFEST).exists():
            inside = [path]
        else:
            inside = sorted(file.parent for file in path.rglob(episode_reader.MANIFEST))
        for folder in inside:
            if folder.name.endswith(episode_reader.PARTIAL):
                refused[str(folder)] = (
                    f"{folder}: never finished; the next recorder start mends it, or"
                    " surg_recording.episode.recovery.recover(parent folder)"
                )
            elif folder.resolve() not in {other.resolve() for other in found}:
                found.append(folder)
    if not found and not refused:
        raise ExportError(f"no recording in {', '.join(map(str, episodes))}")
    return found, refused


def dry_run(
    exporter: Exporter, episodes: Sequence[Path], options: ExportOptions, progress: Progress
) -> Report:
    """Everything but pictures: read and check all tables, and say what an export would hold.

    Raises:
        ExportError: nothing can be exported at all.
    """
    exporter.require()
    plan = make_plan(exporter, episodes, options, progress)
    report = Report(exporter.name, Path(), refused=dict(plan.refused))
    kinds: dict[str, int] = {}
    for number, candidate in enumerate(plan.candidates):
        progress(number / len(plan.candidates), f"reading {candidate.folder.name}")
        try:
            sampled = sample(candidate, options)
        except EpisodeError as problem:
            report.refused[str(candidate.folder)] = str(problem)
            continue
        report.recordings += 1
        report.frames += sampled.grid.frames
        report.warnings += _stretch(str(candidate.folder), sampled.notes)
        kinds[candidate.kind] = kinds.get(candidate.kind, 0) + 1
        report.facts.setdefault("features", {f.name: list(f.shape) for f in sampled.features})
    report.facts["kinds"] = kinds
    return report


def arrange(
    name: str, parts: Sequence[Part], layout: inspection.Layout, options: ExportOptions
) -> Dataset:
    """Order the recordings so that each split is one range: train, val, test, recovery, failure."""
    plain = [part for part in parts if part.kind == SUCCESS]
    groups: dict[str, list[Part]] = {}
    begin, share = 0, 0.0
    for split in SPLITS:
        share += options.splits.get(split, 0.0)
        end = len(plain) if share > 1.0 - 1e-9 else round(share * len(plain))
        groups[split] = plain[begin:end]
        begin = end
    for kind in (RECOVERY, FAILURE):
        groups[kind] = [part for part in parts if part.kind == kind]
    ordered: list[Part] = []
    splits = {}
    for split, members in groups.items():
        if members:
            splits[split] = (len(ordered), len(ordered) + len(members))
            ordered += members
    return Dataset(name, tuple(ordered), splits, layout, options)


def check(out: Path, exporter: Exporter) -> Report:
    """Check a finished export: the exporter's own reading, and the checksum of every file.

    Raises:
        ExportError: it is no export, or of another format.
    """
    stated = read_manifest(out)
    if stated["exporter"] != exporter.name:
        raise ExportError(f"{out}: an export of format {stated['exporter']}, not {exporter.name}")
    report = exporter.validate(out)
    for name, entry in stated["files"].items():
        path = out / name
        if not path.is_file():
            report.errors.append(f"{name}: missing")
        elif file_hash(path) != entry["sha256"]:
            report.errors.append(f"{name}: changed since it was written")
    report.facts["files"] = len(stated["files"])
    return report


def read_manifest(out: Path) -> dict[str, Any]:
    """``surg_export.json`` of an export.

    Raises:
        ExportError: there is none that can be read.
    """
    try:
        stated = json.loads((out / MANIFEST).read_text("utf-8"))
    except (OSError, ValueError) as problem:
        raise ExportError(f"{out}: no export of this program ({MANIFEST}: {problem})") from None
    if not isinstance(stated, dict) or stated.get("format") != FORMAT:
        raise ExportError(f"{out / MANIFEST}: format is not {FORMAT}")
    return stated


def _is_same(
    out: Path, exporter: Exporter, plan: Plan, options: ExportOptions, report: Report
) -> bool:
    """True: the export is there already, of these recordings. False: it may be replaced.

    Raises:
        ExportError: something else lies there.
    """
    if not out.is_dir() or (any(out.iterdir()) and not (out / MANIFEST).exists()):
        raise ExportError(f"--out {out}: holds something that is no export; name another folder")
    if not any(out.iterdir()):
        out.rmdir()
        return False
    stated = read_manifest(out)
    same = stated["exporter"] == exporter.name
    same = same and sorted(r["key"] for r in stated["recordings"]) == sorted(plan.keys)
    same = same and stated["arranged"] == _arranged(options)
    if same:
        sizes = {name: entry["bytes"] for name, entry in stated["files"].items()}
        gone = [n for n, size in sizes.items() if not _has_size(out / n, size)]
        if gone:
            raise ExportError(
                f"{out}: {gone[0]} is missing or changed since it was written; --replace makes the"
                " export anew"
            )
        report.recordings = len(stated["recordings"])
        report.frames = sum(r["frames"] for r in stated["recordings"])
        report.facts["up_to_date"] = True
        return True
    if not options.replace:
        raise ExportError(
            f"--out {out}: holds an export of other recordings or with other options; name another"
            " folder, or take its place with --replace"
        )
    return False


def _has_size(path: Path, size: int) -> bool:
    return path.is_file() and path.stat().st_size == size


def _arranged(options: ExportOptions) -> dict[str, Any]:
    """Choices that change how recordings are put together."""
    return {
        "splits": dict(options.splits),
        "about": json.loads(json.dumps(options.about, default=str)),
    }


def _convert(jobs: list[Job], options: ExportOptions, report: Report, progress: Progress) -> None:
    """Do the jobs that are not done; put what fails under ``refused``."""
    if options.shard is not None:
        index, count = options.shard
        jobs[:] = jobs[index::count]
    todo = [job for job in jobs if not (job.parts / job.key / PART).exists()]
    done = 0

    def note(outcome: Outcome) -> None:
        nonlocal done
        done += 1
        if outcome.problem is not None:
            report.refused[str(outcome.folder)] = outcome.problem
        report.made += outcome.made
        progress(0.1 + 0.85 * done / len(todo), f"{done} of {len(todo)} recordings converted")

    progress(0.1, f"0 of {len(todo)} recordings converted")
    executors.run(todo, options, note)


def _assemble(
    exporter: Exporter, dataset: Dataset, out: Path, options: ExportOptions, report: Report
) -> None:
    """Put together under a temporary name, read back, and give it its name."""
    staging = out.with_name(out.name + UNFINISHED)
    shutil.rmtree(staging, ignore_errors=True)
    staging.mkdir(parents=True)
    try:
        exporter.assemble(dataset, staging)
        found = exporter.validate(staging)
        report.recordings, report.frames = found.recordings, found.frames
        report.errors += found.errors
        report.warnings += found.warnings
        for part in dataset.parts:
            report.warnings += _stretch(part.source, part.notes)
        report.facts.update(found.facts)
        if found.recordings != len(dataset.parts) or found.frames != dataset.frames:
            report.errors.append(
                f"read back {found.recordings} recordings with {found.frames} frames, written were"
                f" {len(dataset.parts)} with {dataset.frames}"
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


def write_manifest(exporter: Exporter, dataset: Dataset, out: Path, report: Report) -> None:
    """Write ``surg_export.json`` into a finished export."""
    files = {
        str(path.relative_to(out)): {"bytes": path.stat().st_size, "sha256": file_hash(path)}
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }
    stated = {
        "format": FORMAT,
        "exporter": exporter.name,
        "exporter_version": exporter.version,
        "options": dataset.options.content(),
        "arranged": _arranged(dataset.options),
        "layout": dataclasses.asdict(dataset.layout),
        "splits": {name: list(ends) for name, ends in dataset.splits.items()},
        "features": [feature.describe() for feature in dataset.features],
        "recordings": [
            {
                "index": index,
                "source": part.source,
                "key": part.key,
                "kind": part.kind,
                "frames": part.frames,
                "instruction": part.instruction,
                "about": dict(part.about),
                "notes": dict(part.notes),
            }
            for index, part in enumerate(dataset.parts)
        ],
        "refused": report.refused,
        "files": files,
    }
    (out / MANIFEST).write_text(json.dumps(stated, indent=1, default=str) + "\n", "utf-8")


def _stretch(source: str, notes: Mapping[str, Any]) -> list[str]:
    """What is said of a recording of which a stretch is exported only."""
    return [f"{source}: {notes['segment']} is exported"] if "segment" in notes else []


def _locator(exporter: Exporter) -> str:
    """How another process finds the exporter: by name, or by its file."""
    return source_file(exporter) or exporter.name


def _nothing_left(report: Report) -> None:
    reasons: Mapping[str, str] = report.refused
    shown = "\n".join(f"  {reason}" for reason in list(reasons.values())[:10])
    raise ExportError(f"no recording can be exported:\n{shown}")
