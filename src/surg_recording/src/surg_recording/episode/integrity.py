"""Compares the files of an episode with what the manifest has stated since the recording.

Every table, sidecar and video has a SHA-256 there. Recordings from before that have none: of them
only the number of rows and the first and last stamp are known.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surg_recording.file_io import file_hash
from surg_recording.recording_errors import EpisodeError

if TYPE_CHECKING:
    from surg_recording.episode.episode_reader import Episode
    from surg_recording.episode.table import Table

HASH, VIDEO_HASH = "sha256", "video_sha256"
"""Keys of an entry of the manifest: hash of a CSV file, and of the video beside a sidecar."""

REMEDY = "restore it from a copy"


def check_rows(path: Path, entry: Mapping[str, Any], table: Table) -> None:
    """Raise an EpisodeError unless a table has the rows, first and last stamp of its entry."""
    rows = entry.get("rows", entry.get("frames"))
    if rows is not None and rows != len(table):
        raise EpisodeError(
            f"{path}: {len(table)} rows, the manifest says {rows}: the file was cut or edited after"
            f" the recording; {REMEDY}"
        )
    if not len(table) or "stamp_ns" not in table:
        return
    stamps = table["stamp_ns"]
    if not stamps.any() and "receive_ns" in table:
        stamps = table["receive_ns"]  # messages without a stamp
    for key, row in (("first_stamp_ns", 0), ("last_stamp_ns", -1)):
        if entry.get(key) is not None and entry[key] != int(stamps[row]):
            raise EpisodeError(
                f"{path}: {key} is {int(stamps[row])}, the manifest says {entry[key]}: the file was"
                f" edited after the recording; {REMEDY}"
            )


def check_hash(path: Path, stated: str | None) -> None:
    """Raise an EpisodeError unless a file has this SHA-256; None: it is not known."""
    if stated is not None and file_hash(path) != stated:
        raise EpisodeError(
            f"{path}: its SHA-256 is not the manifest's: the file was edited after the recording;"
            f" {REMEDY}"
        )


def files(folder: Path, manifest: Mapping[str, Any]) -> dict[Path, str | None]:
    """Every file that the manifest describes, and its SHA-256 there; None without one."""
    found: dict[Path, str | None] = {}
    for name, entry in manifest["tables"].items():
        found[folder / f"{name}.csv"] = entry.get(HASH)
    for name, entry in manifest["videos"].items():
        found[folder / f"{name}.csv"] = entry.get(HASH)
        found[folder / f"{name}.mp4"] = entry.get(VIDEO_HASH)
    return found


def changes(recorded: Episode) -> list[str]:
    """A sentence per file that is missing or not as it was recorded."""
    problems = []
    for path, stated in files(recorded.folder, recorded.manifest).items():
        try:
            check_hash(path, stated)
        except EpisodeError as problem:
            problems.append(str(problem))
    return problems


def remarks(recorded: Episode) -> list[str]:
    """What a reader should be told of an episode: no hashes."""
    if None in files(recorded.folder, recorded.manifest).values():
        return ["recorded without hashes: an edit of a value cannot be noticed"]
    return []
