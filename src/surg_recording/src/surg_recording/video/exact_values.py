"""Frames of measured values, such as depth: as numbers, and as pictures to look at.

The recorder keeps them bit for bit: 16-bit values as grey PNG pictures, 32-bit numbers as the four
bytes of an RGBA picture (``video_encoder.ENCODINGS``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt

from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file

Values = npt.NDArray[Any]

FORMATS = {"gray16be": "16UC1", "rgba": "32FC1"}
"""Pixel formats of the recorder's PNG videos, and what their values are."""


def is_exact(video: av.VideoStream) -> bool:
    """Whether a video holds measured values."""
    codec, pixels = video_file.codec_of(video)
    return codec == "png" and pixels in FORMATS


def read(path: Path, indices: Sequence[int] | None = None) -> Iterator[Values]:
    """The values of a video's frames: (height, width), uint16 or float32, as the camera sent them.

    Args:
        path: Video of a camera whose encoding is mono16, 16UC1 or 32FC1.
        indices: Frames to read, increasing; None: all.

    Raises:
        EpisodeError: The video cannot be read, holds colours, or ends before an index.
    """
    with video_file.opened(path) as container:
        video = container.streams.video[0]
        if not is_exact(video):
            kind = ", ".join(video_file.codec_of(video))
            raise EpisodeError(
                f"{path}: holds no measured values ({kind}); those of mono16, 16UC1 and 32FC1 "
                "cameras can be read"
            )
    yield from map(values, video_file.frames(path, indices))


def values(frame: av.VideoFrame) -> Values:
    """The numbers of a frame, (height, width)."""
    if frame.format.name == "rgba":
        return np.ascontiguousarray(frame.to_ndarray()).view("<f4")[..., 0]
    return frame.to_ndarray(format="gray16le")


def picture(frame: av.VideoFrame) -> av.VideoFrame:
    """A grey picture of a frame's values: near is bright, what is zero or not finite is black."""
    numbers = values(frame).astype(np.float64)
    known = np.isfinite(numbers) & (numbers > 0)
    shown = np.zeros(numbers.shape, np.uint8)
    if known.any():
        near, far = np.percentile(numbers[known], (2, 98))
        share = (far - numbers[known]) / max(far - near, 1e-9)
        shown[known] = np.round(40 + 215 * np.clip(share, 0, 1))
    made = av.VideoFrame.from_ndarray(shown, format="gray")
    made.pts, made.time_base = frame.pts, frame.time_base
    return made
