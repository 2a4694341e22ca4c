"""Finds the grid of a recording: the times at which every series has a value.

The grid begins with the first picture at which all series have begun, the arms are homed and an
action is known. It ends when the first series ends, and lies within the labels' trim.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.contract import SECOND_NS
from surg_recording.datasets import stream_copy
from surg_recording.datasets.frames.resample import Grid, Stamps, offsets_ns
from surg_recording.datasets.options import COPY, ExportOptions
from surg_recording.episode.checked.checked_episode import CheckedEpisode
from surg_recording.episode.checked.long_table import LongTable
from surg_recording.recording_errors import EpisodeError


@dataclasses.dataclass(frozen=True)
class ArmCycles:
    """The control cycles of an arm; those of a commanded arm from homing on."""

    name: str
    table: LongTable
    first: int
    """First row used."""
    commanded: bool

    @classmethod
    def of(cls, table: LongTable, name: str, commanded: bool) -> ArmCycles:
        """The cycles in a checked table; an EpisodeError if a commanded arm was never homed."""
        homed = np.flatnonzero(table.index["homed"] == 1)
        if commanded and not len(homed):
            raise EpisodeError(
                f"{table.path}: {name} was never homed, so its rcm frame is not known"
            )
        return cls(name, table, int(homed[0]) if commanded else 0, commanded)

    @property
    def stamps(self) -> Stamps:
        """(N,) stamps of the used rows [ns]."""
        return self.column("stamp_ns")

    @property
    def command(self) -> Stamps:
        """(N,) kind of the command obeyed; 0: none."""
        return self.column("command")

    def column(self, column: str) -> npt.NDArray[Any]:
        """(N,) a column of the first pass."""
        return self.table.index[column][self.first :]


def common_grid(
    episode: CheckedEpisode, commanded: Sequence[str], options: ExportOptions
) -> tuple[Grid, dict[str, ArmCycles]]:
    """The grid of a recording, and the cycles of its arms; ``commanded``: names of arms.

    Raises:
        EpisodeError: No command was obeyed, or the series overlap too shortly.
    """
    cycles = {
        arm: ArmCycles.of(each, arm, arm in commanded) for arm, each in episode.cycles.items()
    }
    arms = [cycles[arm] for arm in commanded]
    period = int(offsets_ns(np.array([1]), options.fps)[0])
    obeyed = [arm.stamps[arm.command > 0] for arm in arms]
    commands = [int(stamps[0]) for stamps in obeyed if len(stamps)]
    if not commands:
        raise EpisodeError(
            f"{episode.folder}: no motion command was obeyed: there is no action to export"
        )
    long = [*episode.cycles.values(), *episode.truth.values()]
    indices = [*(table.index for table in long), *([episode.task] if episode.task else [])]
    tables = {table.name: table["stamp_ns"] for table in indices}
    videos, trim = list(episode.videos.values()), episode.trim
    pictures_ns = [video.frames["stamp_ns"] for video in videos]
    firsts = [*(arm.stamps[0] for arm in arms), *(s[0] for s in (*pictures_ns, *tables.values()))]
    begin = int(max(*firsts, min(commands) - period, trim[0]))
    # A command answers an observation one tick before it. A grid on the commands' stamps would
    # pair every observation with the answer to the next one.
    observed = tables.pop("task_state", None)
    lasts = [*(arm.stamps[-1] - period for arm in arms)]
    lasts += [s[-1] for s in (*pictures_ns, *tables.values())]
    end = int(min(*lasts, trim[1]))
    reference = pictures_ns[0] if pictures_ns else observed
    if videos and options.video == COPY:  # a copied video begins with a key frame
        video = videos[0]
        keys = video.frames["stamp_ns"][
            np.isin(video.frames["frame"], stream_copy.key_frames(video.path))
        ]
        reference = keys if (keys >= begin).any() else reference
    if reference is not None:
        later = reference[reference >= begin]
        begin = int(later[0]) if len(later) else end + 1
    frames = (end - begin) * options.fps // SECOND_NS + 1 if end >= begin else 0
    if frames < 2:
        raise EpisodeError(
            f"{episode.folder}: {max(frames, 0)} frames at {options.fps} per second: pictures,"
            " motion and commands overlap too shortly to export"
        )
    return Grid(begin, options.fps, int(frames)), cycles
