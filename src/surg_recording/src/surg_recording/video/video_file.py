"""Reads videos of an episode, and repairs those of a killed recorder."""

from __future__ import annotations

import contextlib
import csv
import itertools
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt

from surg_recording.episode import damaged, table_columns
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import mp4_boxes

Image = npt.NDArray[np.uint8]

_INTEGER = re.compile(r"-?\d+$")


def codec_of(video: av.VideoStream) -> tuple[str, str]:
    """Codec and pixel format of a video; ``unknown`` where there is no decoder for it."""
    try:
        return str(video.codec_context.name), str(video.codec_context.pix_fmt)
    except AttributeError:  # PyAV has no codec then, and asks it for its name
        return "unknown", ""


@contextlib.contextmanager
def opened(path: Path) -> Iterator[av.container.InputContainer]:
    """A video to read; an EpisodeError says what does not work with it."""
    try:
        with av.open(str(path)) as container:
            yield container
    except (av.error.FFmpegError, IndexError) as problem:
        raise EpisodeError(f"{path}: no readable video ({problem})") from problem


def packets(container: av.container.InputContainer) -> Iterator[av.Packet]:
    """The packets of a video that hold a frame."""
    for packet in container.demux(container.streams.video[0]):
        if packet.pts is not None and packet.size > 0:
            yield packet


def like(container: av.container.OutputContainer, video: av.VideoStream) -> av.VideoStream:
    """A new stream of a container for the packets of another video."""
    if hasattr(container, "add_stream_from_template"):  # PyAV 14 and later
        return container.add_stream_from_template(video, opaque=True)  # packets only
    return container.add_stream(template=video)


def presentation_times(path: Path) -> list[int]:
    """Presentation time of every frame in microseconds from the first, or an EpisodeError.

    Reads packets only; a truncated file is read as far as possible.
    """
    times: list[int] = []
    try:
        with av.open(str(path)) as container:
            for packet in packets(container):
                times.append(round(packet.pts * packet.time_base * 1_000_000))
    except (av.error.FFmpegError, IndexError) as problem:
        if not times:
            raise EpisodeError(f"{path}: no readable video ({problem})") from problem
    return times


def frames(path: Path, indices: Iterable[int] | None = None) -> Iterator[av.VideoFrame]:
    """Decode frames of a video by never decreasing indices; equal indices repeat a frame.

    Without indices all of them.

    Raises:
        EpisodeError: The video cannot be read, or ends before an index.
    """
    wanted = iter(itertools.count() if indices is None else indices)
    due = next(wanted, None)
    number = -1
    try:
        first = _key_frame(path, due or 0)
        with av.open(str(path)) as container:
            for number, frame in enumerate(decoded(container, first), start=first):
                while due == number:
                    yield frame
                    due = next(wanted, None)
                if due is None:
                    return
    except (av.error.FFmpegError, IndexError) as problem:
        if number < 0:
            raise EpisodeError(f"{path}: no readable video ({problem})") from problem
        raise EpisodeError(f"{path}: cannot be decoded behind frame {number} ({problem})") from None
    if due is not None and indices is not None:
        raise EpisodeError(f"{path}: ends after {number + 1} frames, frame {due} is needed")


def _key_frame(path: Path, number: int) -> int:
    """The last key frame not later than a frame, so that a piece of a long video is found fast."""
    if number == 0:
        return 0
    with av.open(str(path)) as container:
        if container.streams.video[0].codec_context.has_b_frames:
            return 0  # packets and frames are in different order
        head = itertools.islice(packets(container), number + 1)
        return max((n for n, packet in enumerate(head) if packet.is_keyframe), default=0)


def decoded(container: av.container.InputContainer, first: int = 0) -> Iterator[av.VideoFrame]:
    """Frames of a video from the key frame ``first`` on, decoded in this thread.

    Recordings are converted in parallel, so threads would gain nothing; and a decoder thread that
    logs while its container is being closed waits for the interpreter forever.
    """
    context = container.streams.video[0].codec_context
    context.thread_type, context.thread_count = "NONE", 1
    if not first:
        yield from container.decode(video=0)
        return
    for packet in itertools.islice(packets(container), first, None):
        yield from packet.decode()
    yield from context.decode(None)


def grab(path: Path, indices: Sequence[int]) -> list[Image]:
    """Frames by increasing index as (H, W, 3) RGB; of a truncated video as far as it goes."""
    images: list[Image] = []
    try:
        for frame in frames(path, indices):
            images.append(frame.to_ndarray(format="rgb24"))
    except EpisodeError:
        if not images:
            raise
    return images


def mend(path: Path, sidecar: Path, notes: list[str] | None = None) -> int:
    """Make a video and its sidecar agree, in place; returns the number of frames kept.

    A truncated fragment at the end and sidecar lines without a frame are removed. A video with more
    frames than the sidecar has lines loses the fragments behind the last stamp. A file in which
    nothing is readable is left as it is, with an empty sidecar.

    ``notes`` receives a sentence about every change, and what is cut then goes into files of its
    own (``damaged``). None: of a live recording, whose frames go into the next part.
    """
    lines = _sidecar_lines(sidecar)
    whole = mp4_boxes.fragments(path)
    frames, end, total = 0, 0, 0
    for fragment in whole:
        total += fragment.frames
        if total > len(lines):
            break
        frames, end = total, fragment.end
    if mp4_boxes.is_plain(path):  # not made by this recorder
        frames = min(_readable(path), len(lines))
    elif frames and not (fragment is whole[-1] and total == frames and mp4_boxes.is_closed(path)):
        _cut(path, end, notes)
    if len(lines) != frames or not _ends_whole(sidecar):
        _keep(sidecar, lines[:frames], notes)
    return frames


def _cut(path: Path, end: int, notes: list[str] | None) -> None:
    """Truncate a file; with ``notes`` what is cut is kept, and said."""
    removed = path.stat().st_size - end
    if removed <= 0:
        return
    if notes is None:
        os.truncate(path, end)
    else:
        notes.append(damaged.cut_words(path, removed, damaged.cut(path, end)))


def has_frames(path: Path) -> bool:
    """Whether a video holds a readable frame."""
    return _readable(path) > 0


def last_stamp(sidecar: Path) -> int:
    """Stamp of the last line of a sidecar [ns]; -1 without one."""
    lines = _sidecar_lines(sidecar)
    return int(lines[-1][table_columns.VIDEO.index("stamp_ns")]) if lines else -1


def _sidecar_lines(sidecar: Path) -> list[list[str]]:
    """The valid lines at the start of a sidecar; empty without a file."""
    good: list[list[str]] = []
    if not sidecar.exists():
        return good
    with open(sidecar, newline="", encoding="utf-8", errors="replace") as file:
        text = file.read().rpartition("\n")[0]
    for line in csv.reader(text.replace("\0", "").splitlines()[1:]):
        if len(line) != len(table_columns.VIDEO) or not all(
            _INTEGER.match(value) for value in line
        ):
            break
        good.append(line)
    return good


def _keep(sidecar: Path, lines: list[list[str]], notes: list[str] | None) -> None:
    """Truncate a sidecar behind these lines, in place: the disk may be full."""
    data = sidecar.read_bytes() if sidecar.exists() else b""
    ends = [place + 1 for place, byte in enumerate(data) if byte == ord("\n")]
    head = (",".join(table_columns.VIDEO) + "\n").encode()
    if len(ends) > len(lines) and data.startswith(head) and b"\0" not in data[: ends[len(lines)]]:
        _cut(sidecar, ends[len(lines)], notes)
        return
    if notes is not None and data:
        kept = damaged.set_aside(sidecar)
        notes.append(f"{sidecar.name}: {len(lines)} lines of it are usable; as it was: {kept}")
    temporary = sidecar.with_suffix(".csv.tmp")
    with open(temporary, "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([table_columns.VIDEO, *lines])
    os.replace(temporary, sidecar)


def _ends_whole(sidecar: Path) -> bool:
    """Whether the last line of a file is complete."""
    return sidecar.exists() and sidecar.read_bytes().endswith(b"\n")


def _readable(path: Path) -> int:
    try:
        return len(presentation_times(path))
    except EpisodeError:
        return 0
