"""Tells whether two folders hold the same recording, so that no data set counts one twice."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.integrity import HASH
from surg_recording.file_io import file_hash
from surg_recording.recording_errors import EpisodeError

SIMULATION, RECORDING = "the same simulation as", "the same recording as"


class KnownRecordings:
    """The recordings seen so far."""

    def __init__(self) -> None:
        self._folders: dict[tuple[str, str], str] = {}

    def twin(self, recorded: Episode) -> str | None:
        """The recording that this one repeats, in words; None if it is a new one."""
        for (what, value), short in fingerprints(recorded).items():
            if (folder := self._folders.get((what, value))) is not None:
                return f"{what} {folder} ({short})"
        return None

    def add(self, recorded: Episode) -> None:
        """Remember a recording."""
        for key in fingerprints(recorded):
            self._folders.setdefault(key, str(recorded.folder))


def fingerprints(recorded: Episode) -> Mapping[tuple[str, str], str]:
    """What the copies of a recording share, each with a short form for people.

    The state hash of the simulation, and the hash of all tables as they are on the disk. A table
    that cannot be read counts as it was recorded.
    """
    found = {}
    state = (recorded.manifest.get("sim") or {}).get("state_hash")
    if state:
        found[SIMULATION, state] = f"state hash {state[:12]}"
    digest = hashlib.sha256()
    for name in sorted(recorded.tables):
        digest.update(f"{name} {_hash(recorded, name)}\n".encode())
    tables = digest.hexdigest()
    found[RECORDING, tables] = f"hash of the tables {tables[:12]}"
    return found


def identity(recorded: Episode) -> str:
    """A hash that all copies of a recording share, also labelled ones.

    Of the simulation's states; without them of what the manifest says was recorded.
    """
    manifest = recorded.as_recorded
    state = (manifest.get("sim") or {}).get("state_hash")
    words = [str(state)] if state else []
    for name, entry in sorted(manifest["tables"].items()) if not state else ():
        words.append(f"{name} {entry.get(HASH)} {entry.get('rows')} {entry.get('first_stamp_ns')}")
    return hashlib.sha256("\n".join(words).encode()).hexdigest()


def _hash(recorded: Episode, name: str) -> str:
    try:
        return file_hash(recorded.folder / f"{name}.csv")
    except EpisodeError:
        return str(recorded.manifest["tables"][name].get(HASH))
