"""The recorded episodes: the folders beside the recorder's, newest first, with their outcome."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SHOWN = 30
"""Episodes that are listed."""
LARGEST_MANIFEST = 8 << 20
"""[bytes]"""


@dataclass(frozen=True)
class Entry:
    """One episode."""

    name: str
    started: float  # wall clock [s]
    seconds: float | None  # its length [s]; None: not known
    outcome: str  # "complete", "incomplete", "unfinished" (no manifest yet), "unreadable"
    reason: str = ""
    task: str = ""  # the phantom's task; empty: none
    success: bool | None = None  # how that ended; None: no task, or not judged


class Episodes:
    """The list, read again only where a folder has changed.

    Args:
        folder: The recorder's ``~out``: its siblings of the same name are the episodes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[Path, tuple[int, Entry]] = {}

    def entries(self) -> list[Entry]:
        """Newest first, at most `SHOWN`."""
        entries = []
        for path in self._folder.parent.glob(f"{self._folder.name}*"):
            try:
                manifest = path / "manifest.json"
                changed = manifest.stat().st_mtime_ns if manifest.is_file() else 0
                known = self._known.get(path)
                if known is None or known[0] != changed or not changed:
                    known = (changed, _entry(path, changed))
                    self._known[path] = known
            except OSError:  # it is being renamed
                continue
            entries.append(known[1])
        return sorted(entries, key=lambda entry: entry.started, reverse=True)[:SHOWN]


def _entry(path: Path, changed: int) -> Entry:
    """Read one folder."""
    if not changed or path.suffix == ".partial":
        return Entry(path.name.removesuffix(".partial"), path.stat().st_mtime, None, "unfinished")
    file = path / "manifest.json"
    try:
        if file.stat().st_size > LARGEST_MANIFEST:
            raise ValueError("the manifest is too large")
        manifest = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(manifest, dict):
            raise ValueError("the manifest is no JSON object")
    except (ValueError, RecursionError) as error:
        return Entry(path.name, changed * 1e-9, None, "unreadable", str(error)[:200])
    start, stop = _nanoseconds(manifest, "started_ns"), _nanoseconds(manifest, "stopped_ns")
    task = _object(_object(manifest, "sim"), "task")
    judged = bool(task.get("done")) or bool(task.get("success"))
    return Entry(
        name=path.name,
        started=start * 1e-9 if start else changed * 1e-9,
        seconds=(stop - start) * 1e-9 if start and stop > start else None,
        outcome="complete" if manifest.get("outcome") == "complete" else "incomplete",
        reason=str(manifest.get("reason") or ""),
        task=str(task.get("name") or ""),
        success=bool(task.get("success")) if judged else None,
    )


def _object(fields: dict[str, Any], key: str) -> dict[str, Any]:
    value = fields.get(key)
    return value if isinstance(value, dict) else {}


def _nanoseconds(fields: dict[str, Any], key: str) -> int:
    value = fields.get(key)
    return value if isinstance(value, int) and not isinstance(value, bool) else 0
