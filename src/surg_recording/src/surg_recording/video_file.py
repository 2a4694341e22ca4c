"""Reading videos of an episode, and mending those of a killed recorder."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt

from surg_recording import columns
from surg_recording.errors import EpisodeError
from surg_recording.video_encoder import CONTAINER_OPTIONS

Image = npt.NDArray[np.uint8]


def presentation_times(path: Path) -> list[int]:
    """Presentation time of every readable frame, in microseconds from the first.

    Reads packets only. A file that a kill has cut is read as far as it goes.

    Raises:
        EpisodeError: when the file holds no readable video.
    """
    times: list[int] = []
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            for packet in container.demux(stream):
                if packet.pts is not None and packet.size > 0:
                    times.append(round(packet.pts * packet.time_base * 1_000_000))
    except (av.error.FFmpegError, IndexError) as problem:
        if not times:
            raise EpisodeError(f"{path}: no readable video ({problem})") from problem
    return times


def grab(path: Path, indices: Sequence[int]) -> list[Image]:
    """Decode chosen frames as (H, W, 3) RGB; indices must increase. Missing ones are left out."""
    wanted, images = list(indices), []
    try:
        with av.open(str(path)) as container:
            for number, frame in enumerate(container.decode(video=0)):
                if not wanted:
                    break
                if number == wanted[0]:
                    wanted.pop(0)
                    images.append(frame.to_ndarray(format="rgb24"))
    except (av.error.FFmpegError, IndexError) as problem:
        if not images:
            raise EpisodeError(f"{path}: no readable video ({problem})") from problem
    return images


def mend(path: Path, sidecar: Path) -> int:
    """Make video and sidecar of a killed recorder agree; returns the number of frames kept.

    The readable packets are copied into a file with a proper end, and sidecar lines without a
    frame are cut off. A video that holds nothing readable is left as it is, with an empty sidecar.
    """
    try:
        frames = _remux(path)
    except EpisodeError:
        frames = 0
    if sidecar.exists():
        with open(sidecar, newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
        good = [line for line in lines[1:] if len(line) == len(columns.VIDEO)][:frames]
        temporary = sidecar.with_suffix(".csv.tmp")
        with open(temporary, "w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([columns.VIDEO, *good])
        os.replace(temporary, sidecar)
    return frames


def _remux(path: Path) -> int:
    times = presentation_times(path)
    temporary = path.with_suffix(".mp4.tmp")
    copied = 0
    with (
        av.open(str(path)) as source,
        av.open(str(temporary), "w", format="mp4", options=CONTAINER_OPTIONS) as target,
    ):
        stream = target.add_stream(template=source.streams.video[0])
        for packet in source.demux(source.streams.video[0]):
            if packet.pts is None or packet.size == 0:
                continue
            if copied == len(times):
                break
            packet.stream = stream
            target.mux(packet)
            copied += 1
    os.replace(temporary, path)
    return copied
