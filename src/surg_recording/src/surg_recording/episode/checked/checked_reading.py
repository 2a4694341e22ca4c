"""Reads tables and videos of a recording that are as the recorder left them.

Whoever computes with a recording reads it here: exports and evaluations. An edited file, a
truncated file, an impossible stamp or value and a clock step are found before anything is made of
them; the error states file, line and value.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from surg_core.contract import SECOND_NS
from surg_recording.clock import clock_agreement, clock_segments
from surg_recording.clock.clock_segments import GUARD_NS, Segment
from surg_recording.episode import integrity, table_columns
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table, Video
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file

LONGEST_GAP_NS = 3600 * SECOND_NS
"""Stamps of neighbouring rows are closer than this [ns]."""


def segment_of(recorded: Episode) -> Segment | None:
    """The segment to use after a clock step; an EpisodeError if stamps cannot be compared."""
    try:
        segment = clock_segments.longest(recorded.manifest)
    except EpisodeError as problem:
        raise EpisodeError(f"{recorded.folder}: {problem}") from None
    if segment is not None and clock_agreement.machines(recorded.manifest) > 1:
        raise EpisodeError(
            f"{recorded.folder}: {segment.words}; but two machines took part, and it is not known"
            " which of their clocks was set"
        )
    return segment


def checked_table(
    recorded: Episode,
    name: str,
    segment: Segment | None = None,
    columns: Collection[str] | None = None,
    numbered: str | None = None,
) -> Table:
    """A table with the rows and stamps of the manifest, or its rows within a segment.

    Args:
        recorded: The episode.
        name: Name of the table.
        segment: Only rows within it; None for all.
        columns: Columns to read besides the stamps; None for all. The episode does not keep a table
            with some of its columns.
        numbered: Name of a further column with the number of each row in the file, from 0.

    Raises:
        EpisodeError: Truncated, edited or missing; no row in the segment.
    """
    table = recorded.table(name) if columns is None else recorded.columns(name, columns)
    if numbered is not None:
        table = table.with_column(numbered, np.arange(len(table)))
    path = recorded.folder / f"{name}.csv"
    _stamped(path, table)
    if segment is None:
        _forward(path, table)
        return table
    kept = segment.table(table, name)
    _of_the_segment(path, kept, segment)
    _forward(path, kept, int(np.argmax(segment.rows(name, table["receive_ns"]))))
    return kept


def checked_video(recorded: Episode, camera: str, segment: Segment | None = None) -> Video:
    """A video whose frames and times are those of its sidecar; only its frames within a segment.

    Raises:
        EpisodeError: A file is missing, shorter than the other, or their times differ.
    """
    if segment is None:
        return _whole_video(recorded, recorded.video(camera))
    part = segment.video(recorded, camera)
    _whole_video(recorded, recorded.video(part.name))
    _of_the_segment(part.path.with_suffix(".csv"), part.frames, segment)
    return part


def _whole_video(recorded: Episode, video: Video) -> Video:
    """Compare a video with its sidecar, line by line."""
    sidecar = video.path.with_suffix(".csv")
    frames = video.frames
    missing = [name for name in table_columns.VIDEO if name not in frames]
    if missing:
        raise EpisodeError(f"{sidecar}: no column {', '.join(missing)}")
    entry = recorded.manifest["videos"][video.name]
    integrity.check_rows(sidecar, entry, frames)
    _stamped(sidecar, frames)
    _forward(sidecar, frames)
    times = np.array(video_file.presentation_times(video.path), dtype=np.int64)
    if len(times) != len(frames):
        raise EpisodeError(
            f"{video.path}: {len(times)} frames can be read, its sidecar {sidecar.name} lists"
            f" {len(frames)}; one of the files was cut. Record again, or mend both with"
            " surg_recording.video.video_file.mend"
        )
    stamps = frames["stamp_ns"]
    wrong = np.abs(times - frames["pts"]) > 2
    wrong |= np.abs((stamps - stamps[0]) // 1000 - frames["pts"]) > 2
    wrong |= frames["frame"] != np.arange(len(frames))
    if wrong.any():
        line = int(np.flatnonzero(wrong)[0]) + 2
        raise EpisodeError(
            f"{sidecar}, line {line}: frame, stamp_ns and pts do not fit the video"
            " (pts is its presentation time in microseconds since the first frame); was it edited?"
        )
    integrity.check_hash(sidecar, entry.get(integrity.HASH))
    integrity.check_hash(video.path, entry.get(integrity.VIDEO_HASH))
    return video


def _stamped(path: Path, table: Table) -> None:
    """Refuse a table without rows, or without integer stamps."""
    for column in ("stamp_ns", "receive_ns"):
        if column not in table:
            raise EpisodeError(f"{path}: no column {column}")
    if not len(table):
        raise EpisodeError(f"{path}: holds no row")


def _forward(path: Path, table: Table, first: int = 0) -> None:
    """Refuse stamps that go back or jump; ``first`` is the place of the first row in the file."""
    stamps = table["stamp_ns"]
    earlier, later = stamps[:-1], stamps[1:]
    back = np.flatnonzero(later < earlier)
    if len(back):
        row = int(back[0]) + 1
        raise EpisodeError(
            f"{path}, line {first + row + 2}: stamp_ns {stamps[row]} is earlier than"
            f" {stamps[row - 1]} in the line before; the clock was set back, or the file edited"
        )
    if stamps[0] < 0:
        raise EpisodeError(f"{path}, line {first + 2}: stamp_ns {stamps[0]} is before 1970")
    far = np.flatnonzero(later - earlier > LONGEST_GAP_NS)
    if len(far):
        row = int(far[0]) + 1
        raise EpisodeError(
            f"{path}, line {first + row + 2}: stamp_ns {stamps[row]} is"
            f" {(int(stamps[row]) - int(stamps[row - 1])) / SECOND_NS:.0f} s after"
            f" {stamps[row - 1]} in the line before; the clock was set, or the file edited"
        )


def _of_the_segment(path: Path, table: Table, segment: Segment) -> None:
    """Refuse a segment without rows, and stamps that may be on the other side of a step."""
    if not len(table):
        raise EpisodeError(f"{path}: holds no row in it; {segment.words}")
    stamps = table["stamp_ns"]
    apart = np.abs(table["receive_ns"] - stamps)
    apart[stamps == 0] = 0  # not said
    if apart.max() > GUARD_NS:
        raise EpisodeError(
            f"{path}: stamps are up to {apart.max() * 1e-9:.3f} s from their reception, so that it"
            f" cannot be told on which side of a step they are; {segment.words}"
        )
