"""``surg_export.json``: what an export was made of, and the checksum of every file."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from surg_recording.datasets.dataset import Dataset
from surg_recording.datasets.export_report import ExportError, Report
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.options import ExportOptions
from surg_recording.file_io import file_hash

MANIFEST = "surg_export.json"
"""File with the inputs of an export and the checksum of every file."""

FORMAT = "surg_export/1"


def check(out: Path, exporter: Exporter) -> Report:
    """Validate a finished export and its checksums; an ExportError if it is no such export."""
    stated = read_manifest(out)
    if stated["exporter"] != exporter.name:
        raise ExportError(
            f"{out}: an export of format {stated['exporter']}, not {exporter.name}; name its"
            f" format: --format {stated['exporter']}"
        )
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
    """``surg_export.json`` of an export; an ExportError if it cannot be read."""
    try:
        stated = json.loads((out / MANIFEST).read_text("utf-8"))
    except (OSError, ValueError) as problem:
        raise ExportError(f"{out}: no export of this program ({MANIFEST}: {problem})") from None
    if not isinstance(stated, dict) or stated.get("format") != FORMAT:
        raise ExportError(f"{out / MANIFEST}: format is not {FORMAT}")
    return stated


def is_up_to_date(
    out: Path, exporter: Exporter, keys: Sequence[str], options: ExportOptions, report: Report
) -> bool:
    """Whether this export is there already; an ExportError if the folder holds something else."""
    if not out.is_dir() or (any(out.iterdir()) and not (out / MANIFEST).exists()):
        raise ExportError(f"--out {out}: holds something that is no export; name another folder")
    if not any(out.iterdir()):
        out.rmdir()
        return False
    stated = read_manifest(out)
    same = stated["exporter"] == exporter.name
    same = same and {r["key"] for r in stated["recordings"]} == set(keys)
    same = same and {**_arranged(ExportOptions()), **stated["arranged"]} == _arranged(options)
    if same:
        for name, entry in stated["files"].items():
            if not (out / name).is_file() or (out / name).stat().st_size != entry["bytes"]:
                raise ExportError(
                    f"{out}: {name} is missing or changed since it was written; --replace exports"
                    " again"
                )
        report.recordings = len(stated["recordings"])
        report.frames = sum(r["frames"] for r in stated["recordings"])
        report.facts["up_to_date"] = True
        return True
    if not options.replace:
        raise ExportError(
            f"--out {out}: holds an export of other recordings or with other options; name another"
            " folder, or replace it with --replace"
        )
    return False


def _arranged(options: ExportOptions) -> dict[str, Any]:
    """Choices that change how recordings are put together."""
    return {
        "splits": dict(options.splits),
        "split_by": options.split_by,
        "where": options.where,
        "about": json.loads(json.dumps(options.about, default=str)),
    }


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
                **({"piece": part.piece} if part.piece else {}),
            }
            for index, part in enumerate(dataset.parts)
        ],
        "refused": report.refused,
        "files": files,
    }
    (out / MANIFEST).write_text(json.dumps(stated, indent=1, default=str) + "\n", "utf-8")
