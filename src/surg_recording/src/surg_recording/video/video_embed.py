"""Makes a recorded video fit for a page: one seekable file, thinned out if it is too large."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt

from surg_recording.recording_errors import EpisodeError
from surg_recording.video import exact_values, video_file
from surg_recording.video.video_encoder import MICROSECONDS

SMALL_WIDTH = 480
"""Width of a thinned-out video [pixels]."""
SMALL_FRAME = 5000
"""Approximate size of its frames [bytes]; decides how many are left out."""


@dataclasses.dataclass(frozen=True)
class Embedded:
    """An MP4 file in memory, and which frames of the recording it shows."""

    data: bytes
    frames: npt.NDArray[np.int64]
    """(K,) indices into the sidecar, increasing."""
    pts: npt.NDArray[np.int64]
    """(K,) presentation times in ``data`` [µs], increasing."""
    note: str


def embed(path: Path, budget: int, progress: Callable[[int], None] | None = None) -> Embedded:
    """Read a video so that a browser can seek in it; an EpisodeError if it is unreadable.

    The recorder's fragments are joined without encoding them again. A file of more than ``budget``
    bytes, or in a format that browsers do not play, is encoded again: smaller, and perhaps not
    every frame. Measured values become grey pictures.
    """
    try:
        if path.stat().st_size <= budget and _plays(path):
            return _copy(path)
        return _thin_out(path, budget, progress)
    except (av.error.FFmpegError, IndexError, OSError) as problem:
        raise EpisodeError(f"{path}: no readable video ({problem})") from problem


def _plays(path: Path) -> bool:
    """Whether browsers play a video as it is."""
    with av.open(str(path)) as source:
        return video_file.codec_of(source.streams.video[0]) == ("h264", "yuv420p")


def _copy(path: Path) -> Embedded:
    target, pts = io.BytesIO(), []
    with av.open(str(path)) as source, av.open(target, "w", format="mp4") as out:
        stream = video_file.like(out, source.streams.video[0])
        try:
            for packet in video_file.packets(source):
                pts.append(_microseconds(packet))
                packet.stream = stream
                out.mux(packet)
        except av.error.FFmpegError:
            if not pts:  # else: a cut file is shown as far as it goes
                raise
    if not pts:
        raise EpisodeError(f"{path}: the video holds no frame")
    return Embedded(target.getvalue(), np.arange(len(pts)), np.array(pts, dtype=np.int64), "")


def _thin_out(path: Path, budget: int, progress: Callable[[int], None] | None) -> Embedded:
    with av.open(str(path)) as source:
        total = sum(1 for packet in source.demux(video=0) if packet.size)
    nth = max(1, -(-total * SMALL_FRAME // budget))
    target = io.BytesIO()
    frames: list[int] = []
    pts: list[int] = []
    with av.open(str(path)) as source, av.open(target, "w", format="mp4") as out:
        video = source.streams.video[0]
        given, exact = video.codec_context, exact_values.is_exact(video)
        width = min(SMALL_WIDTH, given.width) & ~1
        height = round(given.height * width / given.width) & ~1
        options = {"preset": "veryfast", "crf": "28", "bf": "0"}
        stream: Any = out.add_stream("libx264", rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = stream.codec_context.time_base = MICROSECONDS
        try:
            for number, frame in enumerate(source.decode(video=0)):
                if progress is not None and number % 100 == 0:
                    progress(number)
                if number % nth:
                    continue
                at = _microseconds(frame)
                shown = exact_values.picture(frame) if exact else frame
                small = shown.reformat(width=width, height=height, format="yuv420p")
                small.pts, small.time_base = at, MICROSECONDS
                small.pict_type = 0  # none: the encoder decides
                out.mux(stream.encode(small))
                frames.append(number)
                pts.append(at)
        except av.error.FFmpegError:
            if not pts:
                raise
        out.mux(stream.encode())
    if not pts:
        raise EpisodeError(f"{path}: the video holds no frame")
    note = f"{width}×{height}, " + (f"one frame of {nth}" if nth > 1 else "every frame")
    return Embedded(
        target.getvalue(), np.array(frames), np.array(pts, dtype=np.int64), f"thinned out: {note}"
    )


def _microseconds(timed: Any) -> int:
    return round(timed.pts * timed.time_base * 1_000_000)
