"""Resamples a recording to the grid: every feature of every frame, with true stamps and ages.

An observation is the state at a grid time; an action is the command in force at the next one:
set-point and jaw at that time, with the names of surg_sim.envs.surg_env.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import av
import numpy.typing as npt

from surg_core.contract import SECOND_NS
from surg_recording.datasets import pictures
from surg_recording.datasets.frames import motion_features, task_features
from surg_recording.datasets.frames.arm_motion import motion_of
from surg_recording.datasets.frames.frame_columns import Columns
from surg_recording.datasets.frames.frame_grid import common_grid
from surg_recording.datasets.frames.picture_features import RecordedPictures, shown_pictures
from surg_recording.datasets.frames.resample import Grid
from surg_recording.datasets.inspection import Candidate
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import Feature
from surg_recording.episode.checked.checked_episode import CheckedEpisode
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file


@dataclasses.dataclass(frozen=True)
class Sampled:
    """A recording on its grid."""

    candidate: Candidate
    grid: Grid
    features: tuple[Feature, ...]
    columns: dict[str, npt.NDArray[Any]]
    """By feature name: (frames, D), or (frames,) where D is 1; text as an object array."""
    pictures: dict[str, RecordedPictures]
    notes: dict[str, Any]
    """Facts for the report: repeated, skipped and oldest pictures."""

    def pieces(self, longest_s: float | None) -> list[Sampled]:
        """The recording in pieces of nearly equal length, none longer than ``longest_s`` [s]."""
        fps, frames = self.grid.fps, self.grid.frames
        if longest_s is None or frames <= longest_s * fps:
            return [self]
        count = math.ceil(frames / (math.floor(longest_s) * fps))
        # Pieces begin at whole seconds of the grid: there its times need no rounding.
        ends = [math.ceil(frames / fps * n / count) * fps for n in range(count)] + [frames]
        return [self._piece(first, end) for first, end in itertools.pairwise(ends)]

    def _piece(self, first: int, end: int) -> Sampled:
        """The frames from ``first`` to before ``end``."""
        start = int(self.grid.times_ns[first])
        return dataclasses.replace(
            self,
            grid=dataclasses.replace(self.grid, start_ns=start, frames=end - first),
            columns={name: values[first:end] for name, values in self.columns.items()},
            pictures={
                name: dataclasses.replace(shown, index=shown.index[first:end])
                for name, shown in self.pictures.items()
            },
        )

    def frames(self, feature: str) -> Iterator[av.VideoFrame]:
        """The pictures of a video feature in the grid's order."""
        shown = self.pictures[feature]
        return video_file.frames(shown.video.path, [int(i) for i in shown.index])


def sample(candidate: Candidate, options: ExportOptions) -> Sampled:
    """Read and resample a recording; an EpisodeError names what is missing, broken or too old."""
    layout = candidate.layout
    episode = CheckedEpisode.load(
        candidate.folder,
        segment=candidate.segment,
        arms=layout.arms,
        truth=layout.arms if layout.truth else (),
        forces=layout.commanded if layout.forces else (),
        task=layout.labelled,
        cameras=layout.cameras,
        gap_ns=round(options.max_gap_s * SECOND_NS),
    )
    _check_sizes(episode, layout.sizes)
    grid, cycles = common_grid(episode, layout.commanded, options)
    arms = {arm: motion_of(each, grid) for arm, each in cycles.items()}

    made = Columns(grid, options, episode.gap_ns)
    if episode.segment is not None:
        made.notes["segment"] = episode.segment.words
    if candidate.remarks:
        made.notes["remarks"] = list(candidate.remarks)
    motion_features.motion(made, episode, layout, arms)
    shown = shown_pictures(made, layout.sizes, episode.videos)
    task_features.task(made, episode, candidate)
    features = made.finish()
    return Sampled(candidate, grid, features, made.columns, shown, made.notes)


def _check_sizes(episode: CheckedEpisode, sizes: Sequence[tuple[int, int]]) -> None:
    """Refuse a segment whose pictures have another size than those before it."""
    if episode.segment is None:
        return
    for (camera, video), size in zip(episode.videos.items(), sizes, strict=True):
        if pictures.size_of(video.path) != size:
            raise EpisodeError(
                f"{video.path}: another size than {camera} has before; {episode.segment.words}"
            )
