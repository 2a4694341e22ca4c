"""A recording as a data set may use it: cut to one clock, and every table checked once.

Whoever makes frames of a recording takes its tables from here and checks nothing again. A long
table keeps a few columns of every row; the others are read, and checked, at the rows that are used.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from surg_core.force.observed_force import PLACES
from surg_recording.clock.clock_segments import Segment
from surg_recording.episode import episode_reader, labels
from surg_recording.episode.checked import long_table
from surg_recording.episode.checked.checked_reading import checked_table, checked_video
from surg_recording.episode.checked.long_table import LongTable
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table, Video
from surg_recording.recording_errors import EpisodeError


@dataclasses.dataclass(frozen=True)
class CheckedEpisode:
    """The wanted tables and videos, with the rows and frames that may be used."""

    folder: Path
    manifest: Mapping[str, Any]
    gap_ns: int
    """Samples that are further apart are not bridged."""
    segment: Segment | None
    """The part that was read, of a recording whose clock was set; None: all of it."""
    trim: tuple[int, int]
    """First and last stamp to use by the labels [ns]."""
    cycles: Mapping[str, LongTable]
    """By arm."""
    truth: Mapping[str, LongTable]
    """By arm: the simulator's ground truth."""
    task: Table | None
    forces: Mapping[tuple[str, str], Table | None]
    """By place (``tip``, ``trocar``) and arm; None: the force was never known."""
    videos: Mapping[str, Video]
    """By camera; their sidecars hold the frames to use only."""

    @classmethod
    def load(
        cls,
        folder: Path,
        segment: Segment | None,
        arms: Sequence[str],
        truth: Sequence[str],
        forces: Sequence[str],
        task: bool,
        cameras: Sequence[str],
        gap_ns: int,
    ) -> CheckedEpisode:
        """Read and check.

        Args:
            folder: Of the episode.
            segment: Part to read; None for all.
            arms: Arms whose control cycles are wanted.
            truth: Arms whose ground truth is wanted.
            forces: Arms whose measured forces are wanted.
            task: Whether the task's state is wanted.
            cameras: Cameras whose pictures are wanted.
            gap_ns: Samples closer than this are bridged in any case.

        Raises:
            EpisodeError: A file is missing, cut, edited or holds an impossible stamp or value.
        """
        recorded = episode_reader.read(folder)
        return cls(
            folder=folder,
            manifest=recorded.manifest,
            gap_ns=recorded.bridged_ns(gap_ns),
            segment=segment,
            trim=labels.trim(recorded.manifest),
            cycles={arm: long_table.read(recorded, f"cycle_{arm}", segment) for arm in arms},
            videos={camera: checked_video(recorded, camera, segment) for camera in cameras},
            task=checked_table(recorded, "task_state", segment) if task else None,
            truth={arm: long_table.read(recorded, f"ground_truth_{arm}", segment) for arm in truth},
            forces={
                (place, arm): measured_force(recorded, place, arm, segment)
                for arm in forces
                for place in PLACES
            },
        )


def measured_force(
    recorded: Episode, place: str, arm: str, segment: Segment | None
) -> Table | None:
    """What a sensor said of the force at ``tip`` or ``trocar``; None: it was never known.

    Raises:
        EpisodeError: The table is not as recorded, or a known force is impossible.
    """
    name = f"{place}_force_{arm}"
    if not (recorded.manifest["tables"].get(name) or {}).get("rows"):
        return None
    table = checked_table(recorded, name, segment)
    path = recorded.folder / f"{name}.csv"
    strange = table["known"][~np.isin(table["known"], (0, 1))]
    if strange.size:
        raise EpisodeError(f"{path}: column known: {strange[0]} is neither 1 nor 0")
    table.select(table["known"] == 1).require_finite(path, [f"force_{axis}" for axis in "xyz"])
    return table
