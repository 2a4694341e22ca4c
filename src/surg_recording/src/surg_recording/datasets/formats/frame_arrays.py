"""Pictures as arrays of (N, height, width, 3) uint8 RGB, one frame at a time."""

from __future__ import annotations

from typing import Any

import numpy as np

from surg_recording.datasets import pictures
from surg_recording.datasets.frames.sampling import Sampled
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import Feature
from surg_recording.recording_errors import EpisodeError


def put_frames(stored: Any, sampled: Sampled, feature: Feature, options: ExportOptions) -> None:
    """Write a camera's frames into an array; an EpisodeError if one is missing or another size."""
    done = 0
    for frame in sampled.frames(feature.name):
        image = pictures.rgb(frame, options.size)
        if image.shape != tuple(feature.shape):
            raise EpisodeError(
                f"{feature.name}: a frame of {image.shape}, the first had {feature.shape}"
            )
        stored[done] = image
        done += 1
    if done != sampled.grid.frames:
        raise EpisodeError(f"{feature.name}: {done} frames, the grid has {sampled.grid.frames}")


def check_frames(
    stored: Any, where: object, sampled: Sampled, feature: Feature, options: ExportOptions
) -> None:
    """Compare an array of the file ``where`` with the recording; EpisodeError on a difference."""
    for number, frame in enumerate(sampled.frames(feature.name)):
        if not np.array_equal(stored[number], pictures.rgb(frame, options.size)):
            raise EpisodeError(f"{where}: {stored.name}: frame {number} differs")
