"""Both eyes of a recorded episode: their lenses by the manifest, and pairs of equal stamps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import av
import numpy as np
import numpy.typing as npt

from surg_core import ConfigError
from surg_core.lens_file import Lens, check_eyes
from surg_core.pictures.camera_model import lens_of
from surg_perception.depth.rectification import Picture
from surg_recording.episode.episode_reader import MANIFEST, Episode
from surg_recording.episode.table import Video
from surg_recording.recording_errors import EpisodeError

EYES = ("endoscope_left", "endoscope_right")
"""Names of the cameras in an episode."""
GOOD_CRF = 18
"""Worst quality of video that still carries depth (docs/guide/endoscope/depth.md)."""


@dataclass(frozen=True)
class RecordedPair:
    """Two pictures (h, w, 3), rgb8, of one stamp [ns]."""

    left: Picture
    right: Picture
    stamp_ns: int
    receive_ns: int


class RecordedEyes:
    """The stereo endoscope of an episode.

    Args:
        episode: As ``episode_reader.read`` returns it.

    Raises:
        EpisodeError: It has one eye or none, no lenses, lenses that make no pair, or no two
            pictures of one stamp; says which, and what to do.
    """

    def __init__(self, episode: Episode) -> None:
        self.episode = episode
        missing = [eye for eye in EYES if eye not in episode.cameras]
        if missing:
            there = ", ".join(episode.cameras) or "none"
            raise EpisodeError(
                f"{episode.folder}: has no video {' and no '.join(missing)} (cameras: {there}); "
                "allowed: episodes of a stereo endoscope. Record with "
                "./surg up CELL --cameras stereo"
            )
        self._videos = [episode.parts(eye) for eye in EYES]
        first = [_size(videos[0]) for videos in self._videos]
        self.lenses = self._lenses(first)
        left, right = (
            np.concatenate([part.frames["stamp_ns"] for part in videos]) for videos in self._videos
        )
        self.stamps: npt.NDArray[np.int64] = np.intersect1d(left, right)
        self.unpaired = len(left) + len(right) - 2 * len(self.stamps)
        """Pictures of one eye without one of the other."""
        if not len(self.stamps):
            raise EpisodeError(
                f"{episode.folder}: {len(left)} pictures of the left eye and {len(right)} of the "
                "right one have no stamp in common; allowed: pairs of one stamp, as the capture "
                "node and the simulator send them"
            )

    @property
    def quality(self) -> str:
        """How the videos were encoded: x264's crf or ``lossless``; empty: not stated."""
        stated = (self.episode.manifest.get("camera_streams") or {}).get(EYES[0]) or {}
        return str(stated.get("quality") or "")

    @property
    def coarse(self) -> bool:
        """Whether the videos were encoded too coarsely for depth."""
        return self.quality.isdigit() and int(self.quality) > GOOD_CRF

    def pairs(self) -> Iterator[RecordedPair]:
        """Pairs in order.

        Raises:
            EpisodeError: A video cannot be read, or the pictures change their size.
        """
        wanted = set(map(int, self.stamps))
        left, right = (self._frames(eye, wanted) for eye in (0, 1))
        for (stamp, receive, first), (_, _, second) in zip(left, right, strict=True):
            yield RecordedPair(first, second, stamp, receive)

    def _frames(self, eye: int, wanted: set[int]) -> Iterator[tuple[int, int, Picture]]:
        """Stamp, receive time [ns] and picture of the wanted frames of an eye."""
        lens, left = self.lenses[eye], set(wanted)
        for part in self._videos[eye]:
            stamps, received = part.frames["stamp_ns"], part.frames["receive_ns"]
            try:
                with av.open(str(part.path)) as container:
                    for number, frame in enumerate(container.decode(video=0)):
                        if number >= len(stamps) or int(stamps[number]) not in left:
                            continue
                        if (frame.width, frame.height) != (lens.width, lens.height):
                            raise EpisodeError(
                                f"{part.path}: the pictures change to {frame.width} x "
                                f"{frame.height}, the lens is for {lens.width} x {lens.height}; "
                                "allowed: one size in an episode"
                            )
                        left.remove(int(stamps[number]))
                        picture = frame.to_ndarray(format="rgb24")
                        yield int(stamps[number]), int(received[number]), picture
            except (av.error.FFmpegError, IndexError) as problem:
                raise EpisodeError(f"{part.path}: no readable video ({problem})") from problem
        if left:
            raise EpisodeError(
                f"{self._videos[eye][-1].path}: {len(left)} pictures fewer than its sidecar "
                f"states; run ./surg episode recover {self.episode.folder}"
            )

    def _lenses(self, sizes: list[tuple[int, int]]) -> tuple[Lens, Lens]:
        stated = self.episode.manifest.get("camera_info") or {}
        where = f"{self.episode.folder / MANIFEST}: camera_info"
        try:
            left, right = (
                _fitted(lens_of(f"{where}.{eye}", eye, stated.get(eye)), size)
                for eye, size in zip(EYES, sizes, strict=True)
            )
            check_eyes(left, right, *(f"{self.episode.folder}: camera_info.{eye}" for eye in EYES))
        except ConfigError as problem:
            raise EpisodeError(str(problem)) from problem
        return left, right


def _fitted(lens: Lens, size: tuple[int, int]) -> Lens:
    """The lens for a video: 4:2:0 cuts an odd last row or column off."""
    off = lens.width - size[0], lens.height - size[1]
    if max(off) <= 1 and min(off) >= 0:
        return replace(lens, width=size[0], height=size[1])
    return lens.resized(*size)


def _size(video: Video) -> tuple[int, int]:
    """Width and height of a video [px]."""
    try:
        with av.open(str(video.path)) as container:
            stream = container.streams.video[0]
            return int(stream.width), int(stream.height)
    except (av.error.FFmpegError, IndexError) as problem:
        raise EpisodeError(f"{video.path}: no readable video ({problem})") from problem
