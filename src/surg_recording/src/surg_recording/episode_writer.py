"""Making an episode folder that survives a crash, and mending those of killed recorders.

While it is being written a folder is called ``<name>.partial`` and held by a file lock that the
recorder and its encoders share. ``finalise`` completes it and renames it in one step, so a folder
without the suffix is always whole. ``recover`` finishes what a killed recorder left.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import json
import math
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from surg_recording import video_file
from surg_recording.episode import FORMAT, MANIFEST, PARTIAL
from surg_recording.errors import EpisodeError

MIN_FREE_BYTES = 2 << 30
"""A recording does not start with less free space than this [bytes]."""

_LOCK = ".lock"
_RESERVE = ".reserve"
_RESERVE_BYTES = 1 << 20
"""Given back before the manifest is written, so that it fits on a disk that has become full."""


class EpisodeWriter:
    """A folder under construction.

    Attributes:
        folder: where to put files now, ``<final>.partial``.
        final: where it will be. When that name is taken, ``_2``, ``_3``, … is appended.
    """

    def __init__(
        self, final: Path, manifest: Mapping[str, Any], min_free_bytes: int = MIN_FREE_BYTES
    ) -> None:
        """Create the folder and a first manifest, so that a killed recording can be told apart.

        Raises:
            EpisodeError: too little space, or the folder cannot be made.
        """
        try:
            final.parent.mkdir(parents=True, exist_ok=True)
            free = shutil.disk_usage(final.parent).free
            if free < min_free_bytes:
                raise EpisodeError(
                    f"{final.parent}: {free / 2**20:.0f} MiB free, recording needs at least"
                    f" {min_free_bytes / 2**20:.0f} MiB (parameter min_free_bytes)"
                )
            self.final, self.folder = _make_folder(final)
            self._lock = os.open(self.folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o644)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with open(self.folder / _RESERVE, "wb") as file:
                os.posix_fallocate(file.fileno(), 0, _RESERVE_BYTES)
            self.manifest: dict[str, Any] = {
                "format": FORMAT,
                "created": utc_now(),
                **manifest,
                "outcome": "recording",
                "reason": None,
                "tables": {},
                "videos": {},
            }
            write_json(self.folder / MANIFEST, self.manifest)
        except OSError as problem:
            raise EpisodeError(f"{final}: cannot record here: {problem.strerror}") from problem

    @property
    def lock(self) -> int:
        """File descriptor of the lock: encoders inherit it."""
        return self._lock

    def free_bytes(self) -> int:
        """Space left on the episode's disk."""
        return shutil.disk_usage(self.folder).free

    def finalise(
        self, manifest: Mapping[str, Any], drops: Mapping[str, int], reason: str | None
    ) -> Path:
        """Complete the folder and give it its name.

        Args:
            manifest: keys to add to those given at the start.
            drops: per table or video, what was received but not written.
            reason: why the recording is incomplete; None when it is complete.

        Returns:
            The finished folder.

        Raises:
            EpisodeError: when the disk refuses even the manifest; the folder then stays
                ``.partial`` and is mended by ``recover``.
        """
        try:
            (self.folder / _RESERVE).unlink(missing_ok=True)
            self.manifest.update(manifest)
            _complete(self.folder, self.manifest, drops, reason)
            (self.folder / _LOCK).unlink(missing_ok=True)
            os.rename(self.folder, self.final)
            _sync_folder(self.final.parent)
        except OSError as problem:
            raise EpisodeError(
                f"{self.folder}: cannot be finished: {problem.strerror}; it is mended at the next"
                " start when there is space"
            ) from problem
        finally:
            os.close(self._lock)
        return self.final


def recover(parent: Path, name: str | None = None) -> list[Path]:
    """Finish the ``.partial`` folders in ``parent`` that no living recorder holds.

    Cut CSV lines are removed, videos are made to agree with their sidecars, the manifest says
    ``incomplete`` and why, and the folder gets its final name.

    Args:
        parent: the folder that holds episode folders.
        name: only episodes of this name (and ``name_2``, …); None for all.

    Returns:
        The finished folders. A folder that cannot be mended is left as it is.
    """
    done: list[Path] = []
    if not parent.is_dir():
        return done
    for folder in sorted(parent.glob(f"*{PARTIAL}")):
        final = folder.with_name(folder.name[: -len(PARTIAL)])
        if name is not None and final.name != name and not final.name.startswith(f"{name}_"):
            continue
        with contextlib.suppress(OSError, EpisodeError):
            if _recover_one(folder, final):
                done.append(final)
    return done


def _recover_one(folder: Path, final: Path) -> bool:
    lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False  # still being written
        (folder / _RESERVE).unlink(missing_ok=True)
        try:
            manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            manifest = {"format": FORMAT, "created": utc_now(), "arms": []}
        for video in folder.glob("*.mp4"):
            video_file.mend(video, video.with_suffix(".csv"))
        manifest["recovered"] = utc_now()
        _complete(folder, manifest, {}, "the recorder was killed; recovered at the next start")
        (folder / _LOCK).unlink(missing_ok=True)
        os.rename(folder, final)
        _sync_folder(final.parent)
        return True
    finally:
        os.close(lock)


def _make_folder(final: Path) -> tuple[Path, Path]:
    for number in range(1, 10_000):
        name = final if number == 1 else final.with_name(f"{final.name}_{number}")
        folder = name.with_name(name.name + PARTIAL)
        if name.exists():
            continue
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return name, folder
    raise EpisodeError(f"{final}: 9999 episodes of this name already lie there")


def _complete(
    folder: Path, manifest: dict[str, Any], drops: Mapping[str, int], reason: str | None
) -> None:
    """Cut broken ends, count what is there, write the manifest."""
    tables, videos = {}, {}
    for path in sorted(folder.glob("*.csv")):
        cut_broken_end(path)
        entry = describe_table(path)
        entry["dropped"] = int(drops.get(path.stem, 0))
        if path.with_suffix(".mp4").exists():
            videos[path.stem] = {"file": f"{path.stem}.mp4", "sidecar": path.name, **entry}
            videos[path.stem]["frames"] = videos[path.stem].pop("rows")
        else:
            tables[path.stem] = {"file": path.name, **entry}
    manifest.update(
        tables=tables,
        videos=videos,
        outcome="complete" if reason is None else "incomplete",
        reason=reason,
        finished=utc_now(),
    )
    write_json(folder / MANIFEST, manifest)


def cut_broken_end(path: Path) -> int:
    """Cut a CSV file behind its last newline; returns the number of bytes removed.

    A kill or a full disk can only break the last line, because lines are appended.
    """
    with open(path, "rb+") as file:
        size = end = file.seek(0, os.SEEK_END)
        while end > 0:
            start = max(0, end - 65536)
            file.seek(start)
            newline = file.read(end - start).rfind(b"\n")
            if newline >= 0:
                end = start + newline + 1
                break
            end = start
        if end < size:
            file.truncate(end)
        return size - end


def describe_table(path: Path) -> dict[str, Any]:
    """Rows, rate and gaps of a CSV file, from its stamps and ticks.

    ``rate_hz`` is rows − 1 over the time from first to last stamp. A gap is a distance of more than
    1.5 times the median; ``missing_ticks`` counts ticks between the first and the last that have
    no row.
    """
    with open(path, encoding="utf-8", errors="replace") as file:
        header = file.readline().rstrip("\n").split(",")
        wanted = [header.index(name) for name in ("stamp_ns", "receive_ns") if name in header]
        tick = header.index("tick") if "tick" in header else None
        # The columns asked for stand before any text, so that splitting at commas is right.
        parts = max([*wanted, tick or 0], default=0) + 2
        lines = [line.split(",", parts) for line in file]
    entry: dict[str, Any] = {"columns": header, "rows": len(lines)}
    entry.update(first_stamp_ns=None, last_stamp_ns=None, rate_hz=None, gap_max_s=None, gaps=0)
    if len(wanted) < 2 or not lines:
        return entry
    stamps = np.array([int(line[wanted[0]]) for line in lines], dtype=np.int64)
    entry["first_stamp_ns"], entry["last_stamp_ns"] = int(stamps[0]), int(stamps[-1])
    if len(stamps) > 1:
        distance = np.diff(stamps) * 1e-9
        span = (stamps[-1] - stamps[0]) * 1e-9
        entry["rate_hz"] = float((len(stamps) - 1) / span) if span > 0 else None
        entry["gap_max_s"] = float(distance.max())
        entry["gaps"] = int(np.sum(distance > 1.5 * np.median(distance)))
    if tick is not None:
        ticks = np.array([int(line[tick]) for line in lines], dtype=np.int64)
        entry["missing_ticks"] = int(ticks.max() - ticks.min() + 1 - len(np.unique(ticks)))
    return entry


def utc_now() -> str:
    """Now in UTC, ISO 8601 with seconds."""
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def clean_json(value: Any) -> Any:
    """The value with numpy numbers as Python's and non-finite ones as None (JSON has no NaN)."""
    if isinstance(value, Mapping):
        return {str(key): clean_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [clean_json(item) for item in value]
    if isinstance(value, np.ndarray):
        return clean_json(value.tolist())
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value


def write_json(path: Path, value: Any) -> None:
    """Write JSON by way of a temporary file, so that a reader never sees half of it."""
    temporary = path.with_name(path.name + ".tmp")
    with open(temporary, "w", encoding="utf-8") as file:
        json.dump(clean_json(value), file, indent=1, allow_nan=False, default=str)
        file.write("\n")
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def _sync_folder(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
