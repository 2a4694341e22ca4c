"""Makes a recording that was changed by a test look as if it had been recorded so."""

from __future__ import annotations

import json
from pathlib import Path

from surg_recording.episode import finishing
from surg_recording.file_io import file_hash


def restate(folder: Path) -> Path:
    """Describe every table and video in the manifest as the files are now."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text("utf-8"))
    for name, entry in manifest["tables"].items():
        entry.update(finishing.describe_table(folder / f"{name}.csv"))
    for name, entry in manifest["videos"].items():
        found = finishing.describe_table(folder / f"{name}.csv")
        found["frames"] = found.pop("rows")
        entry.update(found, video_sha256=file_hash(folder / f"{name}.mp4"))
    path.write_text(json.dumps(manifest), "utf-8")
    return folder


def without_hashes(folder: Path) -> Path:
    """As a recording of an earlier version."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text("utf-8"))
    for entry in [*manifest["tables"].values(), *manifest["videos"].values()]:
        entry.pop("sha256", None)
        entry.pop("video_sha256", None)
    path.write_text(json.dumps(manifest), "utf-8")
    return folder


def edit_field(file: Path, line: int, column: str, value: str) -> None:
    """Change one field of a CSV file; line 0 is the header."""
    lines = file.read_text("utf-8").splitlines()
    fields = lines[line].split(",")
    fields[lines[0].split(",").index(column)] = value
    lines[line] = ",".join(fields)
    file.write_text("\n".join(lines) + "\n", "utf-8")
