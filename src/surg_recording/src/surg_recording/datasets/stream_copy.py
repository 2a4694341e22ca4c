"""Takes a recorded video into a data set without encoding it a second time.

That is possible where each frame of the grid is the recording's next frame, the first one is a key
frame, and the recording already has the data set's format: H.264, 4:2:0, the same size.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import av

from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.pictures import TICKS
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file


def key_frames(path: Path) -> list[int]:
    """Indices of a video's key frames.

    Raises:
        EpisodeError: The video cannot be read.
    """
    with video_file.opened(path) as container:
        packets = enumerate(video_file.packets(container))
        return [number for number, packet in packets if packet.is_keyframe]


def obstacle(path: Path, indices: Sequence[int], how: ExportOptions) -> str | None:
    """Why frames of a recorded video cannot be copied in this order; None: they can.

    Raises:
        EpisodeError: The video cannot be read.
    """
    first = indices[0]
    if list(indices) != list(range(first, first + len(indices))):
        return f"{how.fps} frames per second are not its own frames one by one"
    with video_file.opened(path) as container:
        context = container.streams.video[0].codec_context
        size = (context.width, context.height)
        codec, pixels = video_file.codec_of(container.streams.video[0])
        if (codec, pixels) != ("h264", "yuv420p") or context.has_b_frames:
            return f"it is {codec}, {pixels}; H.264, yuv420p is written"
        if how.size not in (None, size):
            return f"it has {size[0]}x{size[1]} pixels"
        packet = next(itertools.islice(video_file.packets(container), first, None), None)
    if packet is None or not packet.is_keyframe:
        return f"frame {first}, the first, is no key frame"
    return None


def copy(path: Path, indices: Sequence[int], target: Path, how: ExportOptions) -> int:
    """Copy consecutive frames, shown at n / fps; returns their number.

    Raises:
        EpisodeError: The video cannot be read, or ends too early.
    """
    options = {"movflags": "faststart", "video_track_timescale": str(how.fps * TICKS)}
    even = target.with_suffix(".even.mp4")
    count = 0
    try:
        _evenly(path, indices, even, options, how.fps)
        with (
            av.open(str(even)) as source,
            av.open(str(target), "w", format="mp4", options=options) as container,
        ):
            stream = video_file.like(container, source.streams.video[0])
            for packet in itertools.islice(video_file.packets(source), len(indices)):
                packet.stream = stream
                container.mux(packet)
                count += 1
    except (av.error.FFmpegError, IndexError) as problem:
        raise EpisodeError(f"{path}: cannot be copied behind frame {count} ({problem})") from None
    finally:
        even.unlink(missing_ok=True)
    if count != len(indices):
        raise EpisodeError(f"{path}: {count} of {len(indices)} frames could be copied")
    return count


def _evenly(
    path: Path, indices: Sequence[int], even: Path, options: dict[str, str], fps: int
) -> None:
    """Write the frames at n / fps, and the last one twice.

    A frame lasts until the next one, but a recording does not know how long its last frame, or the
    last one of a fragment, lasts. With one more behind them all of them last 1 / fps.
    """
    with (
        av.open(str(path)) as source,
        av.open(str(path)) as again,
        av.open(str(even), "w", format="mp4", options=options) as container,
    ):
        stream = video_file.like(container, source.streams.video[0])
        wanted = itertools.islice(video_file.packets(source), indices[0], indices[-1] + 1)
        last = itertools.islice(video_file.packets(again), indices[-1], indices[-1] + 1)
        for number, packet in enumerate(itertools.chain(wanted, last)):
            packet.pts = packet.dts = round(number / (fps * packet.time_base))
            packet.stream = stream
            container.mux(packet)
