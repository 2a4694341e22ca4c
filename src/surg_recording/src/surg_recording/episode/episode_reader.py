"""Reads an episode folder; ``episode_writer`` writes one.

A folder holds ``manifest.json``, CSV tables, and per camera an MP4 with a sidecar CSV. The format
is versioned; a reader for every published version stays here (docs/reference/recording.md).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_core.contract import SECOND_NS
from surg_recording.episode import integrity, labels, manifest_check
from surg_recording.episode.table import Table, Video
from surg_recording.episode.table_file import concatenated, read_blocks, read_table
from surg_recording.file_io import read_json, regular_file
from surg_recording.recording_errors import EpisodeError

FORMAT = "surg_episode/1"

MANIFEST = "manifest.json"
TOPICS = "topics"
"""Folder of the tables of topics that have no table of their own kind."""

PARTIAL = ".partial"
"""Suffix of a folder whose recording has not been finished."""

_BLOCK = 16384
"""Rows in memory while a whole file is checked."""


class Episode:
    """A finished episode folder. Tables are read on first use."""

    def __init__(
        self,
        folder: Path,
        manifest: Mapping[str, Any],
        as_recorded: Mapping[str, Any] | None = None,
    ) -> None:
        self.folder = folder
        self.manifest = manifest
        self.as_recorded = manifest if as_recorded is None else as_recorded
        """The manifest on the disk: without labels."""
        self._tables: dict[str, Table] = {}

    @property
    def arms(self) -> list[str]:
        """Names of the recorded arms."""
        return list(self.manifest.get("arms", []))

    @property
    def tables(self) -> list[str]:
        """Names of the tables, e.g. ``cycle_PSM1``."""
        return list(self.manifest["tables"])

    @property
    def cameras(self) -> list[str]:
        """Names of the recorded cameras, e.g. ``endoscope_left``; see ``parts``."""
        return [n for n, entry in self.manifest["videos"].items() if not _part_of(entry)]

    @property
    def topics(self) -> dict[str, list[str]]:
        """Names of the tables of each further topic."""
        stated = self.manifest.get("topics")
        entries = stated.items() if isinstance(stated, dict) else ()
        tables = self.manifest["tables"]
        return {
            topic: [name for name in entry.get("tables", ()) if name in tables]
            for topic, entry in entries
            if isinstance(entry, dict) and entry.get("tables")
        }

    @property
    def stages(self) -> list[dict[str, Any]]:
        """Stages in order: ``name``, ``begin_ns``, ``end_ns``."""
        return list(self.manifest.get("stages") or [])

    @property
    def tags(self) -> list[dict[str, Any]]:
        """Tags in order: ``stamp_ns``, ``text``, ``by``."""
        return list(self.manifest.get("tags") or [])

    @property
    def segments(self) -> list[dict[str, Any]]:
        """Steps of the wall clock; stamps before and after one cannot be compared."""
        return list(self.manifest.get("segments") or [])

    @property
    def warnings(self) -> list[str]:
        """Warnings of the recorder."""
        return list(self.manifest.get("warnings") or [])

    @property
    def complete(self) -> bool:
        """Whether the recording ended normally and nothing was lost."""
        return self.manifest.get("outcome") == "complete"

    def bridged_ns(self, least_ns: int) -> int:
        """Longest time between two samples that is no gap [ns]: of an import 1.5 of its periods."""
        imported = self.manifest.get("imported")
        period = imported.get("period_s") if isinstance(imported, dict) else None
        if not isinstance(period, float) or not 0.0 < period < 10.0:
            return least_ns
        return max(least_ns, round(1.5 * period * SECOND_NS))

    def holding(self, tables: Mapping[str, Table]) -> Episode:
        """The same episode with these tables instead of those in its files."""
        held = Episode(self.folder, self.manifest, self.as_recorded)
        held._tables = {**self._tables, **tables}
        return held

    def table(self, name: str) -> Table:
        """Read a table; an EpisodeError if there is none, or if its file is not as recorded.

        A broken file is named with its line, an edited one by its rows, stamps or hash.
        """
        if name not in self._tables:
            self._tables[name] = self._read(name, None)
        return self._tables[name]

    def columns(self, name: str, wanted: Collection[str]) -> Table:
        """The stamps and these columns of a table, checked as ``table`` does, and not kept."""
        return self._read(name, {"stamp_ns", "receive_ns", *wanted})

    def _read(self, name: str, wanted: Collection[str] | None) -> Table:
        if name not in self.manifest["tables"]:
            why = self.manifest.get("reason")
            raise EpisodeError(
                f"{self.folder}: no table {name!r}; there are {', '.join(self.tables)}"
                + (f" (the recording is incomplete: {why})" if why else "")
            )
        entry, path = self.manifest["tables"][name], self.folder / f"{name}.csv"
        if wanted is None:
            table = read_table(path, entry.get("kinds"))
        else:
            table = concatenated(read_blocks(path, entry.get("kinds"), wanted, _BLOCK))
        integrity.check_rows(path, entry, table)
        try:
            integrity.check_hash(path, entry.get(integrity.HASH))
        except EpisodeError:
            for _ in read_blocks(path, entry.get("kinds"), rows=_BLOCK):
                pass  # a value in a column that was not read says more than the hash
            raise
        return table

    def topic(self, topic: str) -> list[Table]:
        """The tables of a topic (several if its arrays grew); an EpisodeError if not recorded."""
        if topic not in self.topics:
            known = ", ".join(self.topics) or "none"
            raise EpisodeError(f"{self.folder}: no topic {topic!r}; there are {known}")
        return [self.table(name) for name in self.topics[topic]]

    def cycle(self, arm: str) -> Table:
        """The control cycles of an arm."""
        return self.table(f"cycle_{arm}")

    def ground_truth(self, arm: str) -> Table | None:
        """The simulator's ground truth of an arm; None without a simulator."""
        name = f"ground_truth_{arm}"
        if name not in self.manifest["tables"]:
            return None
        table = self.table(name)
        return table if len(table) else None

    def video(self, name: str) -> Video:
        """A camera's video with its sidecar; an EpisodeError if either is missing."""
        if name not in self.manifest["videos"]:
            raise EpisodeError(
                f"{self.folder}: no video {name!r}; there are {', '.join(self.cameras) or 'none'}"
            )
        path = regular_file(self.folder / f"{name}.mp4")
        return Video(name, path, read_table(self.folder / f"{name}.csv"))

    def parts(self, camera: str) -> list[Video]:
        """All videos of a camera in order: several if its size changed or its encoder was killed.

        Raises:
            EpisodeError: No such camera, or a file is missing.
        """
        further = [n for n, entry in self.manifest["videos"].items() if _part_of(entry) == camera]
        further.sort(key=lambda name: int(name.rpartition(".")[2]))
        return [self.video(name) for name in (camera, *further)]


def _part_of(entry: Any) -> str | None:
    """The camera that a video continues; None for its first video."""
    return entry.get("part_of") if isinstance(entry, dict) else None


def read(folder: Path | str) -> Episode:
    """Open an episode folder of any version; an EpisodeError states what to do otherwise."""
    folder = Path(folder)
    path = folder / MANIFEST
    if folder.name.endswith(PARTIAL):
        raise EpisodeError(
            f"{folder}: this recording was never finished; the next recorder start mends it, or"
            f" ./surg episode recover {folder}"
        )
    if not folder.is_dir():
        raise EpisodeError(f"{folder}: no such folder")
    if not os.path.lexists(path):
        raise EpisodeError(f"{folder}: no episode, {MANIFEST} is missing")
    manifest = read_json(path)
    name = manifest.get("format") if isinstance(manifest, dict) else None
    if not isinstance(name, str) or name not in _READERS:
        raise EpisodeError(
            f"{path}: format is {name!r}; this version reads {', '.join(_READERS)}."
            " A newer format needs a newer surg_recording"
        )
    return _READERS[name](folder, manifest)


def find(paths: Sequence[Path]) -> list[Path]:
    """Episode folders at or below the paths, each once; a path without any beside others too.

    Raises:
        EpisodeError: There is no such path, or no episode at all.
    """
    found = {path: below(path) for path in paths}
    if not any(found.values()):
        words = ", ".join(map(str, paths))
        raise EpisodeError(f"{words}: no episode (a folder with {MANIFEST}) in it")
    folders = [folder for path, here in found.items() for folder in here or [path]]
    unique: dict[Path, Path] = {}
    for folder in folders:
        unique.setdefault(folder.resolve(), folder)
    return list(unique.values())


def below(path: Path) -> list[Path]:
    """The episode folders at or below a path, by name; an EpisodeError if there is no such path."""
    if not path.is_dir():
        raise EpisodeError(f"{path}: no such folder")
    if os.path.lexists(path / MANIFEST):
        return [path]
    return [file.parent for file in sorted(path.rglob(MANIFEST)) if _may_be_an_episode(file)]


def _may_be_an_episode(manifest: Path) -> bool:
    try:
        content = read_json(manifest)
    except EpisodeError:
        return True
    return isinstance(content, dict) and str(content.get("format", "")).startswith("surg_episode/")


def _read_1(folder: Path, manifest: dict[str, Any]) -> Episode:
    manifest_check.check(folder / MANIFEST, manifest)
    stated = labels.read(folder)
    labelled = manifest if stated is None else labels.apply(manifest, stated)
    return Episode(folder, labelled, manifest)


_READERS: dict[str, Callable[[Path, dict[str, Any]], Episode]] = {"surg_episode/1": _read_1}
