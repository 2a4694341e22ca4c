"""Converts one recording, checks it, and renames it to its final place in one step.

The place is named after the hash of all inputs, so a job may run twice, anywhere, or be killed: the
first result wins, and a partial result is never visible.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import shutil
import socket
import tempfile
from pathlib import Path

import surg_recording
from surg_core.force.observed_force import PLACES
from surg_recording.datasets import exporter_plugins, inspection, schema
from surg_recording.datasets.dataset import Part
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.frames.sampling import sample
from surg_recording.datasets.layout import Layout
from surg_recording.datasets.options import ExportOptions
from surg_recording.episode.labels import LABELS
from surg_recording.file_io import file_hash
from surg_recording.recording_errors import words_of

_UNFINISHED = ".unfinished-"


@dataclasses.dataclass(frozen=True)
class ConversionJob:
    """The input of a worker; it can be sent to another machine with the same disk."""

    folder: Path
    exporter: str
    """Name or path, for ``exporter_plugins.load``."""
    options: ExportOptions
    layout: Layout
    key: str
    parts: Path


@dataclasses.dataclass(frozen=True)
class ConversionResult:
    """Result of a job."""

    folder: Path
    key: str
    problem: str | None = None
    """Why there is no part; None if there is one."""
    made: bool = False


def input_hash(folder: Path, layout: Layout, options: ExportOptions, exporter: Exporter) -> str:
    """SHA-256 of all inputs of a conversion; an EpisodeError if a file is missing."""
    names = ["manifest.json", inspection.SYNC_REPORT, LABELS]
    names += [f"cycle_{arm}.csv" for arm in layout.arms]
    names += [f"ground_truth_{arm}.csv" for arm in layout.arms if layout.truth]
    if layout.forces:
        forces = [f"{place}_force_{arm}.csv" for place in PLACES for arm in layout.commanded]
        names += [name for name in forces if (folder / name).exists()]
    names += ["task_state.csv"] if layout.labelled else []
    for camera in layout.cameras:
        names += [f"{camera}.mp4", f"{camera}.csv"]
        names += sorted(p.name for p in folder.glob(f"{camera}.[0-9]*") if p.suffix != ".tmp")
    files = {}
    for name in names:
        path = folder / name
        if name in (inspection.SYNC_REPORT, LABELS) and not path.exists():
            continue
        files[name] = file_hash(path)
    stated = {
        "files": files,
        "layout": dataclasses.asdict(layout),
        "options": options.content(),
        "exporter": [exporter.name, exporter.version, surg_recording.__version__],
    }
    return hashlib.sha256(json.dumps(stated, sort_keys=True, default=str).encode()).hexdigest()


def convert(job: ConversionJob) -> ConversionResult:
    """Convert a recording unless that is done. Never raises: the outcome states the problem."""
    try:
        return ConversionResult(job.folder, job.key, made=_convert(job))
    except Exception as problem:  # an exporter's or a library's own: one recording, not the export
        return ConversionResult(job.folder, job.key, words_of(problem, job.folder))


def _convert(job: ConversionJob) -> bool:
    place = job.parts / job.key
    if place.exists():
        return False
    exporter = exporter_plugins.load(job.exporter)
    candidate = inspection.inspect(job.folder, job.options)
    sampled = sample(candidate, job.options)
    owner = f"{_UNFINISHED}{socket.gethostname()}-{os.getpid()}-"
    work = Path(tempfile.mkdtemp(prefix=owner, dir=job.parts))
    try:
        pieces = sampled.pieces(exporter.longest_s)
        for number, piece in enumerate(pieces, start=1):
            folder = work / str(number)
            folder.mkdir()
            exporter.write_part(piece, folder, job.options)
            Part(
                folder=folder,
                key=job.key,
                source=str(job.folder),
                kind=candidate.kind,
                instruction=candidate.instruction,
                stages=tuple(dict.fromkeys(piece.columns.get(schema.STAGE, ()))),
                frames=piece.grid.frames,
                fps=job.options.fps,
                features=piece.features,
                about=candidate.about,
                notes=sampled.notes,
                piece=f"{number} of {len(pieces)}" if len(pieces) > 1 else "",
            ).save()
        os.chmod(work, 0o755)
        try:
            os.rename(work, place)
        except OSError:
            if not place.exists():  # no other worker was faster
                raise
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return True


def remove_unfinished(parts: Path) -> None:
    """Remove unfinished folders of killed workers of this machine."""
    here = f"{_UNFINISHED}{socket.gethostname()}-"
    for folder in parts.glob(f"{here}*"):
        owner = folder.name[len(here) :].partition("-")[0]
        if owner.isdigit() and not Path(f"/proc/{owner}").exists():
            with contextlib.suppress(OSError):
                shutil.rmtree(folder)
