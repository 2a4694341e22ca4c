"""Pictures of an export: encoding, joining, reading back.

A video of an export has a constant rate: frame n is shown at n / fps exactly. Key frames are close
(training reads in random order) and there are no B-frames, so that packets can be joined without
encoding again.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt

from surg_recording.datasets.options import ExportOptions
from surg_recording.file_io import regular_file
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file

Image = npt.NDArray[np.uint8]
Print = npt.NDArray[np.uint8]

PRINT_SIZE = (16, 12)
"""Width and height of the thumbnail that identifies a frame."""

TICKS = 1000
"""Time base of a video: 1 / (fps · TICKS), in which every n / fps is whole."""


@dataclasses.dataclass
class PictureStatistics:
    """Notes about passing frames: thumbnails of all, colours of some."""

    prints: list[Print] = dataclasses.field(default_factory=list)
    histogram: npt.NDArray[np.int64] = dataclasses.field(
        default_factory=lambda: np.zeros((3, 256), np.int64)
    )
    """Counts of the 256 levels of red, green, blue."""
    sampled: int = 0
    """Frames that went into the histogram."""


def _scaled(frame: av.VideoFrame, size: tuple[int, int] | None) -> av.VideoFrame:
    if size is None or (frame.width, frame.height) == size:
        return frame
    return frame.reformat(width=size[0], height=size[1], interpolation="AREA")


def rgb(frame: av.VideoFrame, size: tuple[int, int] | None = None) -> Image:
    """A frame as (height, width, 3) RGB, scaled to ``size`` (width, height)."""
    return _scaled(frame, size).to_ndarray(format="rgb24")


def thumbnail(frame: av.VideoFrame) -> Print:
    """Mean grey of a few blocks: enough to tell frames apart, insensitive to compression."""
    width, height = PRINT_SIZE
    small = frame.reformat(width=width, height=height, format="gray", interpolation="AREA")
    return small.to_ndarray()


def colours(image: Image) -> npt.NDArray[np.int64]:
    """(3, 256) counts of the levels in a picture, of every n-th pixel in each direction."""
    step = max(1, min(image.shape[:2]) // 150)
    part = image[::step, ::step]
    return np.stack([np.bincount(part[..., c].ravel(), minlength=256) for c in range(3)])


def watch(
    frames: Iterable[av.VideoFrame],
    statistics: PictureStatistics,
    count: int,
    size: tuple[int, int] | None = None,
) -> Iterator[av.VideoFrame]:
    """Pass on ``count`` frames; note thumbnails of all, and colours of evenly spaced ones."""
    counted = min(count, max(100, int(count**0.75)))  # of their colours
    chosen = set(np.unique(np.linspace(0, max(count - 1, 0), num=counted).astype(int)))
    for number, frame in enumerate(frames):
        frame = _scaled(frame, size)
        statistics.prints.append(thumbnail(frame))
        if number in chosen:
            statistics.histogram += colours(frame.to_ndarray(format="rgb24"))
            statistics.sampled += 1
        yield frame


def encode(frames: Iterable[av.VideoFrame], path: Path, how: ExportOptions) -> int:
    """Write frames as H.264 (yuv420p) of constant rate; returns their number."""
    count = 0
    options = {"movflags": "faststart", "video_track_timescale": str(how.fps * TICKS)}
    with av.open(str(path), "w", format="mp4", options=options) as container:
        stream = container.add_stream("libx264", rate=how.fps)
        stream.options = {"crf": str(how.crf), "preset": how.preset, "bf": "0"}
        stream.pix_fmt = "yuv420p"
        stream.codec_context.gop_size = how.gop
        stream.codec_context.thread_count = 1  # recordings run side by side
        for frame in frames:
            if count == 0:
                stream.width, stream.height = how.size or (frame.width, frame.height)
            frame = frame.reformat(
                width=stream.width, height=stream.height, format="yuv420p", interpolation="AREA"
            )
            frame.pict_type = 0  # none: the encoder decides, not the recording's
            frame.pts, frame.time_base = count, Fraction(1, how.fps)
            container.mux(stream.encode(frame))
            count += 1
        if count:
            container.mux(stream.encode())
    return count


def join(parts: Sequence[Path], path: Path, fps: int) -> list[int]:
    """Concatenate videos without encoding them again; returns the first frame of each.

    An EpisodeError if one was encoded differently.
    """
    starts: list[int] = []
    done = 0
    options = {"movflags": "faststart", "video_track_timescale": str(fps * TICKS)}
    with av.open(str(path), "w", format="mp4", options=options) as target:
        stream: av.video.stream.VideoStream | None = None
        header = b""
        for part in parts:
            starts.append(done)
            with av.open(str(part)) as source:
                video, done_here = source.streams.video[0], 0
                if stream is None:
                    header = bytes(video.codec_context.extradata or b"")
                    stream = video_file.like(target, video)
                elif bytes(video.codec_context.extradata or b"") != header:
                    raise EpisodeError(f"{part}: encoded differently from {parts[0]}")
                for packet in video_file.packets(source):
                    frame = Fraction(packet.pts) * packet.time_base * fps
                    packet.pts = packet.dts = round((done + frame) / (fps * packet.time_base))
                    packet.stream = stream
                    target.mux(packet)
                    done_here += 1
                done += done_here
    return starts


def header_of(path: Path) -> bytes:
    """The decoder's settings of a video; only equal ones can be joined."""
    with av.open(str(path)) as container:
        return bytes(container.streams.video[0].codec_context.extradata or b"")


def size_of(path: Path) -> tuple[int, int]:
    """Width and height of a video [px]; an EpisodeError if it cannot be read."""
    regular_file(path)
    with video_file.opened(path) as container:
        context = container.streams.video[0].codec_context
        return (int(context.width), int(context.height))


def check_video(path: Path, how: ExportOptions, expected: Sequence[Print]) -> None:
    """Read a video back: number, times and thumbnails of frames; EpisodeError on a difference."""
    tolerance = 4 + 0.4 * how.crf
    number = -1
    try:
        with av.open(str(path)) as container:
            for number, frame in enumerate(video_file.decoded(container)):
                if number >= len(expected):
                    raise EpisodeError(f"{path}: more than the {len(expected)} frames given to it")
                shown = Fraction(frame.pts) * frame.time_base
                if shown != Fraction(number, how.fps):
                    raise EpisodeError(
                        f"{path}: frame {number} is shown at {float(shown):.6f} s instead of"
                        f" {number / how.fps:.6f} s"
                    )
                off = np.abs(thumbnail(frame).astype(int) - expected[number]).max()
                if off > tolerance:
                    raise EpisodeError(
                        f"{path}: frame {number} shows another picture than was given to it"
                        f" (blocks differ by {off} grey levels, at most {tolerance:.0f})"
                    )
    except (av.error.FFmpegError, IndexError) as problem:
        raise EpisodeError(f"{path}: what was written cannot be read ({problem})") from None
    if number + 1 != len(expected):
        raise EpisodeError(f"{path}: {number + 1} frames were written, {len(expected)} are needed")


def video_facts(path: Path) -> dict[str, object]:
    """Size, codec, pixel format, rate and frames of a video, and whether its times are n / fps."""
    with av.open(str(path)) as container:
        video = container.streams.video[0]
        context = video.codec_context
        times = sorted(Fraction(p.pts) * p.time_base for p in video_file.packets(container))
        rate = video.average_rate
        return {
            "width": context.width,
            "height": context.height,
            "codec": context.name,
            "pix_fmt": context.pix_fmt,
            "fps": float(rate) if rate else 0.0,
            "frames": len(times),
            "on_grid": bool(rate) and all(t == Fraction(n) / rate for n, t in enumerate(times)),
        }


def link_or_copy(source: Path, target: Path) -> None:
    """Hard-link a file, or those of a folder, under another name; copy where that is impossible."""
    if source.is_dir():
        for file in source.iterdir():
            link_or_copy(file, target / file.name)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        target.write_bytes(source.read_bytes())
