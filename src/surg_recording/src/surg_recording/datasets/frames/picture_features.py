"""The features of cameras: which recorded picture each grid time shows."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from surg_core.contract import SECOND_NS, image_key
from surg_recording.datasets.frames.frame_columns import Columns
from surg_recording.datasets.frames.resample import Stamps, previous
from surg_recording.datasets.schema import Feature
from surg_recording.episode.table import Video


@dataclasses.dataclass(frozen=True)
class RecordedPictures:
    """The recorded frame of each grid time."""

    video: Video
    index: Stamps
    """(frames,) indices into the recorded video's frames."""


def shown_pictures(
    made: Columns, sizes: Sequence[tuple[int, int]], videos: Mapping[str, Video]
) -> dict[str, RecordedPictures]:
    """The picture of each grid time; ``sizes`` are width and height of each camera [px]."""
    shown: dict[str, RecordedPictures] = {}
    limit = round(made.options.max_image_age_s * SECOND_NS)
    for (camera, video), size in zip(videos.items(), sizes, strict=True):
        stamps = video.frames["stamp_ns"]
        index = previous(stamps, made.grid.times_ns, f"{video.path}", limit)
        width, height = made.options.size or size
        name = image_key(camera)
        feature = Feature(
            name=name,
            dtype="video",
            shape=(height, width, 3),
            names=("height", "width", "channels"),
            method="newest picture that is not later",
            text=f"camera {camera}, RGB",
            camera=camera,
        )
        made.add(feature, None)
        if name in made.dropped:
            continue
        made.timing(camera, stamps, index, made.grid.times_ns, f"stamp of the picture of {camera}")
        steps = np.diff(index)
        made.notes[f"repeated_{camera}"] = int(np.sum(steps == 0))
        made.notes[f"skipped_{camera}"] = int(np.sum(np.maximum(steps - 1, 0)))
        shown[name] = RecordedPictures(video, video.frames["frame"][index])
    return shown
