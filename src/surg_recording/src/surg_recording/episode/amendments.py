"""Declares deliberate edits of a recording, so that it can be used again: who, when, what, why."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from surg_recording.episode import episode_reader, finishing, table_file
from surg_recording.episode.integrity import HASH, VIDEO_HASH
from surg_recording.file_io import file_hash
from surg_recording.recording_errors import EpisodeError

_DESCRIBED = (HASH, "rows", "frames", "first_stamp_ns", "last_stamp_ns")
"""Facts by which an edit is noticed."""


def amend(folder: Path, by: str, why: str) -> dict[str, Any]:
    """Take the files of an episode as they are now, and note the edit in the manifest.

    Args:
        folder: A finished episode.
        by: Who made the edit.
        why: What was edited, and for what reason.

    Returns:
        The entry of ``amendments``: ``at``, ``by``, ``why``, and ``files`` with both hashes.

    Raises:
        EpisodeError: A file is missing or unreadable, or no file differs from the manifest.
    """
    recorded = episode_reader.read(folder)
    manifest = dict(recorded.as_recorded)
    changed: dict[str, Any] = {}
    for kind in ("tables", "videos"):
        manifest[kind] = {
            name: _restated(folder, name, entry, changed) for name, entry in manifest[kind].items()
        }
    if not changed:
        raise EpisodeError(f"{folder}: no file differs from the manifest: nothing to declare")
    note = {"at": finishing.utc_now(), "by": by, "why": why, "files": changed}
    manifest["amendments"] = [*recorded.amendments, note]
    try:
        finishing.write_json(folder / episode_reader.MANIFEST, manifest)
    except OSError as problem:
        raise EpisodeError(f"{folder}: cannot be amended: {problem.strerror}") from problem
    return note


def _restated(
    folder: Path, name: str, entry: dict[str, Any], changed: dict[str, Any]
) -> dict[str, Any]:
    """The entry of a table or video as its files are now; differences go to ``changed``."""
    path = folder / f"{name}.csv"
    table_file.read_table(path, entry.get("kinds"))
    found = finishing.describe_table(path)
    if problem := found.pop("problem", None):
        raise EpisodeError(f"{path}: {problem}")
    if "frames" in entry:
        found["frames"] = found.pop("rows")
    restated = dict(entry)
    if any(key in found and entry.get(key) not in (None, found[key]) for key in _DESCRIBED):
        changed[path.name] = {"before": entry.get(HASH), "after": found[HASH]}
        restated.update(found)
    if "frames" in entry and entry.get(VIDEO_HASH) is not None:
        video = folder / f"{name}.mp4"
        if (after := file_hash(video)) != entry[VIDEO_HASH]:
            changed[video.name] = {"before": entry[VIDEO_HASH], "after": after}
            restated[VIDEO_HASH] = after
    return restated
