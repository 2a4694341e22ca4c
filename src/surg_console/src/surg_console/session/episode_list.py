"""The recorded episodes: the folders beside the recorder's, newest first, with their outcome."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surg_console.labelling.label_file import DISCARDED
from surg_recording.episode import labels
from surg_recording.episode.episode_reader import MANIFEST, PARTIAL
from surg_recording.episode.verdicts import verdict
from surg_recording.file_io import read_json
from surg_recording.recording_errors import EpisodeError
from surg_recording.video.camera_set import STALLED

SHOWN = 30
"""Episodes that are listed."""
READ = (MANIFEST, labels.LABELS, DISCARDED)
"""Files of an episode that say how it ended."""
EXPORT = "./surg episode export needs --allow old-pictures"
LARGEST_MANIFEST = 8 << 20
"""[bytes]"""


@dataclass(frozen=True)
class Entry:
    """One episode."""

    name: str
    started: float  # wall clock [s]
    seconds: float | None  # its length [s]; None: not known
    files: str  # "complete", "with old pictures", "incomplete", "unreadable", "discarded", or
    # "unfinished": no manifest yet
    outcome: str = ""  # the verdict's word; empty: there is no manifest
    reason: str = ""  # of both
    by: str = ""  # who judged: "person", "task"; empty: nobody


class Episodes:
    """The list, read again only where a folder has changed.

    Args:
        folder: The recorder's ``~out``: its siblings of the same name are the episodes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        # Not what lies beside an episode, such as its page or its depth.
        self._name = re.compile(rf"{re.escape(folder.name)}(_\d+)?({re.escape(PARTIAL)})?")
        self._known: dict[Path, tuple[tuple[tuple[str, int], ...], Entry]] = {}

    def has(self, folder: Path) -> bool:
        """Whether a folder is one of these episodes, on this machine."""
        own = folder.parent == self._folder.parent and self._name.fullmatch(folder.name)
        return bool(own) and folder.is_dir()

    def entries(self) -> list[Entry]:
        """Newest first, at most `SHOWN`."""
        entries = []
        for path in self._folder.parent.glob("*"):
            if not self._name.fullmatch(path.name):
                continue
            try:
                files = [f for name in READ if (f := path / name).is_file()]
                changed = tuple((file.name, file.stat().st_mtime_ns) for file in files)
                known = self._known.get(path)
                if known is None or known[0] != changed or not changed:
                    known = (changed, _entry(path))
                    self._known[path] = known
            except OSError:  # it is being renamed
                continue
            entries.append(known[1])
        return sorted(entries, key=lambda entry: entry.started, reverse=True)[:SHOWN]


def _entry(path: Path) -> Entry:
    """Read one folder."""
    changed = path.stat().st_mtime
    if (path / DISCARDED).is_file():
        return Entry(path.name, changed, None, "discarded")
    if not (path / MANIFEST).is_file() or path.suffix == PARTIAL:
        return Entry(path.name.removesuffix(PARTIAL), changed, None, "unfinished")
    try:
        if (path / MANIFEST).stat().st_size > LARGEST_MANIFEST:
            raise ValueError("the manifest is too large")
        manifest = read_json(path / MANIFEST)
        if not isinstance(manifest, dict):
            raise ValueError("the manifest is no JSON object")
        given = labels.read(path)
    except (ValueError, EpisodeError) as error:
        return Entry(path.name, changed, None, "unreadable", "", str(error)[:200])
    start, stop = _nanoseconds(manifest, "started_ns"), _nanoseconds(manifest, "stopped_ns")
    warnings = manifest.get("warnings")
    stalls = (
        [said for said in map(str, warnings) if STALLED in said]
        if isinstance(warnings, list)
        else []
    )
    stalls += [EXPORT] if stalls else []
    complete = "with old pictures" if stalls else "complete"
    judged = verdict(manifest if given is None else {**manifest, labels.KEY: given})
    return Entry(
        name=path.name,
        started=start * 1e-9 if start else changed,
        seconds=(stop - start) * 1e-9 if start and stop > start else None,
        files=complete if manifest.get("outcome") == "complete" else "incomplete",
        outcome=judged.outcome,
        reason="; ".join(filter(None, (str(manifest.get("reason") or ""), *stalls, judged.reason))),
        by=judged.by or "",
    )


def _nanoseconds(fields: dict[str, Any], key: str) -> int:
    value = fields.get(key)
    return value if isinstance(value, int) and not isinstance(value, bool) else 0
