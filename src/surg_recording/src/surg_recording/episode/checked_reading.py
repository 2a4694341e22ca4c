"""Reads tables and videos of a recording that are as the recorder left them.

An edited file, a truncated file and a clock step are found here, before a dataset is made of it;
the error states file, line and value.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from surg_recording.clock.clock_segments import GUARD_NS, Segment
from surg_recording.episode import episode_reader, table_columns
from surg_recording.episode.episode_reader import Episode, Table
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file


def checked_table(recorded: Episode, name: str, segment: Segment | None = None) -> Table:
    """A table with the rows and stamps of the manifest, or its rows within a segment.

    Raises:
        EpisodeError: Truncated, edited or missing; no row in the segment.
    """
    table = recorded.table(name)
    entry = recorded.manifest["tables"][name]
    path = recorded.folder / f"{name}.csv"
    _as_recorded(path, entry, entry.get("rows"), table)
    if segment is None:
        _forward(path, table)
        return table
    kept = segment.table(table, name)
    _of_the_segment(path, kept, segment)
    _forward(path, kept, int(np.argmax(segment.rows(name, table["receive_ns"]))))
    return kept


def checked_video(
    recorded: Episode, camera: str, segment: Segment | None = None
) -> episode_reader.Video:
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


def _whole_video(recorded: Episode, video: episode_reader.Video) -> episode_reader.Video:
    """Compare a video with its sidecar, line by line."""
    sidecar = video.path.with_suffix(".csv")
    frames = video.frames
    missing = [name for name in table_columns.VIDEO if name not in frames]
    if missing:
        raise EpisodeError(f"{sidecar}: no column {', '.join(missing)}")
    entry = recorded.manifest["videos"][video.name]
    _as_recorded(sidecar, entry, entry.get("frames"), frames)
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
    return video


def _as_recorded(path: Path, entry: Any, rows: Any, table: Table) -> None:
    """Compare a file with its entry in the manifest."""
    if rows is not None and rows != len(table):
        raise EpisodeError(
            f"{path}: {len(table)} rows, the manifest says {rows}: the file was cut or edited after"
            " the recording; restore it"
        )
    if not len(table):
        raise EpisodeError(f"{path}: holds no row")
    stamps = table["stamp_ns"]
    for key, row in (("first_stamp_ns", 0), ("last_stamp_ns", -1)):
        if entry.get(key) is not None and entry[key] != int(stamps[row]):
            raise EpisodeError(
                f"{path}: {key} is {int(stamps[row])}, the manifest says {entry[key]}: the file was"
                " edited after the recording; restore it"
            )


def _forward(path: Path, table: Table, first: int = 0) -> None:
    """Refuse stamps that go back; ``first`` is the position of the first row in the file."""
    stamps = table["stamp_ns"]
    back = np.flatnonzero(np.diff(stamps) < 0)
    if len(back):
        row = int(back[0]) + 1
        raise EpisodeError(
            f"{path}, line {first + row + 2}: stamp_ns {stamps[row]} is earlier than"
            f" {stamps[row - 1]} in the line before; the clock was set back, or the file edited"
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


def checked_cycle(recorded: Episode, name: str, segment: Segment | None = None) -> Table:
    """An arm's control cycles with strictly increasing stamps, all measured values finite.

    Raises:
        EpisodeError: Truncated, edited or missing, or a non-finite value.
    """
    path = recorded.folder / f"cycle_{name}.csv"
    cycle = checked_table(recorded, f"cycle_{name}", segment)
    # A cycle without a new joint state repeats its stamp: the last one knows most.
    cycle = cycle.select(np.flatnonzero(np.append(np.diff(cycle["stamp_ns"]) > 0, True)))
    joints = table_columns.joint_count(cycle.columns)
    used = [*("p_tip_x", "p_tip_y", "p_tip_z", "s_x", "s_y", "s_z", "roll", "jaw")]
    used += [f"{prefix}{i}" for prefix in ("q", "qd") for i in range(joints)]
    for column in used:
        bad = np.flatnonzero(~np.isfinite(cycle[column]))
        if len(bad):
            raise EpisodeError(
                f"{path}, column {column}: not a number at stamp_ns {cycle['stamp_ns'][bad[0]]}"
            )
    return cycle
