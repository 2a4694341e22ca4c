"""Short films of episodes for reports, papers and talks: H.264 or an animated GIF."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt
from PIL import Image as PilImage

from surg_recording.episode.table import Video
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file

Image = npt.NDArray[np.uint8]

FPS = 15
"""Frames per second of a film."""
MAX_BYTES = 2_000_000
"""Size that a film stays below."""
KINDS = (".mp4", ".gif")
_GIF_STEP = 2
"""A GIF holds every second frame."""


def times(first_ns: int, last_ns: int, seconds: float) -> list[int]:
    """Times of the frames [ns]: of all of an episode, faster if it is longer than ``seconds``."""
    length = min((last_ns - first_ns) * 1e-9, seconds)
    count = max(round(length * FPS), 2)
    return [int(t) for t in np.linspace(first_ns, last_ns, count)]


def frames_at(video: Video, times_ns: Sequence[int], size: tuple[int, int]) -> Iterator[Image]:
    """The newest frame at each time, (height, width, 3) RGB, scaled to ``size`` (width, height).

    Before the first frame of the video the first one.
    """
    stamps = video.frames["stamp_ns"]
    wanted = np.maximum(np.searchsorted(stamps, times_ns, side="right") - 1, 0)
    for frame in video_file.frames(video.path, wanted.tolist()):
        yield frame.reformat(width=size[0], height=size[1], format="rgb24").to_ndarray()


def beside(*streams: Iterable[Image]) -> Iterator[Image]:
    """The pictures of several streams beside one another; they have one height."""
    for pictures in zip(*streams, strict=True):
        gap = np.zeros((pictures[0].shape[0], 8, 3), dtype=np.uint8)
        joined = [part for picture in pictures for part in (gap, picture)][1:]
        yield np.concatenate(joined, axis=1)


def write(pictures: Iterable[Image], count: int, path: Path, max_bytes: int = MAX_BYTES) -> Path:
    """Write a film of ``count`` pictures with even sides as ``.mp4`` or ``.gif``; returns its path.

    An MP4 stays below ``max_bytes``: its data rate is limited.

    Raises:
        EpisodeError: Another ending, or the file cannot be written.
    """
    if path.suffix not in KINDS:
        raise EpisodeError(f"{path}: a film ends in {' or '.join(KINDS)}")
    try:
        if path.suffix == ".gif":
            _write_gif(pictures, path)
        else:
            _write_mp4(pictures, count, path, max_bytes)
    except (OSError, av.error.FFmpegError) as problem:
        raise EpisodeError(f"{path}: cannot be written: {problem}") from problem
    return path


def _write_mp4(pictures: Iterable[Image], count: int, path: Path, max_bytes: int) -> None:
    bits = 8 * max_bytes
    limits = {"maxrate": str(int(0.75 * bits * FPS / count)), "bufsize": str(int(0.1 * bits))}
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", rate=FPS)
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "24", "preset": "veryfast", **limits}
        for picture in pictures:
            stream.height, stream.width = picture.shape[:2]
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _write_gif(pictures: Iterable[Image], path: Path) -> None:
    kept = [
        PilImage.fromarray(picture).quantize(128)
        for number, picture in enumerate(pictures)
        if number % _GIF_STEP == 0
    ]
    duration = 1000 * _GIF_STEP // FPS
    kept[0].save(path, save_all=True, append_images=kept[1:], duration=duration, loop=0)
