"""Writes what a person says of an episode."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surg_recording.episode import finishing, labels
from surg_recording.episode.episode_reader import MANIFEST
from surg_recording.recording_errors import EpisodeError

DISCARDED = "discarded.json"
"""What the manifest of a discarded episode is called: no command takes the folder then."""


def save(folder: Path, stated: Mapping[str, Any], by: str) -> dict[str, Any]:
    """Write labels into the side file of an episode, and return them.

    Raises:
        ValueError: They are not allowed; names the key.
        EpisodeError: The file cannot be written.
    """
    found = labels.parse({**stated, "by": by, "at": finishing.utc_now()})
    try:
        finishing.write_json(folder / labels.LABELS, found)
    except OSError as problem:
        raise EpisodeError(f"{folder}: cannot be labelled: {problem.strerror}") from None
    return found


def judge(folder: Path, success: bool, by: str) -> None:
    """Set the verdict alone; other labels stay.

    Raises:
        EpisodeError: There are labels that cannot be read, or the file cannot be written.
    """
    save(folder, {**(labels.read(folder) or {}), "success": success}, by)


def discard(folder: Path) -> None:
    """Take an episode out of every list; renaming `DISCARDED` back to the manifest undoes it.

    Raises:
        EpisodeError: It cannot be renamed.
    """
    try:
        (folder / MANIFEST).rename(folder / DISCARDED)
    except OSError as problem:
        raise EpisodeError(f"{folder}: cannot be discarded: {problem.strerror}") from None
