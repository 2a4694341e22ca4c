"""Creates an episode folder that survives a crash.

While it is written a folder is called ``<name>.partial`` and held by a file lock that the recorder
and its encoders share. ``finalise`` completes it and renames it in one step, so a folder without
the suffix is always complete. ``recovery`` finishes the folder of a killed recorder.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surg_recording.episode.episode_reader import FORMAT, MANIFEST, PARTIAL
from surg_recording.episode.finishing import complete, utc_now, write_json
from surg_recording.file_io import sync_folder
from surg_recording.recording_errors import EpisodeError

MIN_FREE_BYTES = 2 << 30
"""A recording does not start with less free space than this [bytes]."""

STOP_FREE_BYTES = 32 << 20
"""Free space at which a recording ends by itself [bytes]; leaves room to finish the folder."""

DISK_CHECK_S = 0.5
"""Period of the check of free disk space [s]."""

LOCK = ".lock"
RESERVE = ".reserve"
_RESERVE_BYTES = 1 << 20
"""Given back before the manifest is written, so that it fits on a disk that has become full."""


class EpisodeWriter:
    """A folder under construction: ``folder`` (``<final>.partial``) will be renamed to ``final``.

    If that name is taken, ``_2``, ``_3``, … is appended.
    """

    def __init__(
        self, final: Path, manifest: Mapping[str, Any], min_free_bytes: int = MIN_FREE_BYTES
    ) -> None:
        """Create the folder and a first manifest, so that a killed recording can be recognised.

        Raises:
            EpisodeError: Too little space, or the folder cannot be created.
        """
        self.disk_lost = False
        """Whether the disk was found full or broken."""
        self._disk_checked = 0.0
        try:
            final.parent.mkdir(parents=True, exist_ok=True)
            free = shutil.disk_usage(final.parent).free
            if free < min_free_bytes:
                raise EpisodeError(
                    f"{final.parent}: {free / 2**20:.0f} MiB free, recording needs at least"
                    f" {min_free_bytes / 2**20:.0f} MiB (parameter min_free_bytes)"
                )
            self.final, self.folder = _make_folder(final)
        except OSError as problem:
            raise EpisodeError(f"{final}: cannot record here: {problem.strerror}") from problem
        self.manifest: dict[str, Any] = {
            "format": FORMAT,
            "created": utc_now(),
            **manifest,
            "outcome": "recording",
            "reason": None,
            "tables": {},
            "videos": {},
        }
        try:
            self._lock = os.open(self.folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with open(self.folder / RESERVE, "wb") as file:
                os.posix_fallocate(file.fileno(), 0, _RESERVE_BYTES)
            write_json(self.folder / MANIFEST, self.manifest)
        except OSError as problem:
            shutil.rmtree(self.folder, ignore_errors=True)  # nothing has been recorded in it
            raise EpisodeError(f"{final}: cannot record here: {problem.strerror}") from problem

    @property
    def lock(self) -> int:
        """File descriptor of the lock, inherited by encoders."""
        return self._lock

    def disk_problem(self, least_bytes: int) -> str | None:
        """Look at the disk from time to time; why it is full or broken, once."""
        if self.disk_lost or time.monotonic() - self._disk_checked <= DISK_CHECK_S:
            return None
        self._disk_checked = time.monotonic()
        try:
            free = shutil.disk_usage(self.folder).free
        except OSError as problem:
            self.disk_lost = True
            return f"disk lost: {problem.strerror}"
        self.disk_lost = free < least_bytes
        return f"disk full: {free / 2**20:.0f} MiB left" if self.disk_lost else None

    def finalise(
        self, manifest: Mapping[str, Any], drops: Mapping[str, int], reason: str | None
    ) -> Path:
        """Complete the folder, rename it and return it; ``drops`` counts what was not written.

        ``reason`` states why the recording is incomplete. An EpisodeError if the disk refuses even
        the manifest; ``recovery`` then finishes the folder.
        """
        try:
            (self.folder / RESERVE).unlink(missing_ok=True)
            self.manifest.update(manifest)
            complete(self.folder, self.manifest, drops, reason)
            (self.folder / LOCK).unlink(missing_ok=True)
            os.rename(self.folder, self.final)
            sync_folder(self.final.parent)
        except OSError as problem:
            raise EpisodeError(
                f"{self.folder}: cannot be finished: {problem.strerror}; it is mended at the next"
                " start when there is space"
            ) from problem
        finally:
            os.close(self._lock)
        return self.final


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
