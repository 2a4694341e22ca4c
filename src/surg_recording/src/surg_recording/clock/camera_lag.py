"""Whether a video shows the state that the kinematics have at the same time."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.transforms import virtual_tip
from surg_recording.clock.clock_segments import Segment
from surg_recording.clock.verdict import CANNOT_TELL
from surg_recording.episode import table_file
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import image_motion, video_lag

Stamps = npt.NDArray[np.int64]
Column = npt.NDArray[np.float64]
Progress = Callable[[str], None]

ASSISTANT_TABLE = "command_assistant"
"""Commands to the assistant's instrument; no controller measures its motion."""


def lags(
    episode: Episode, segment: Segment | None, progress: Progress | None
) -> dict[str, dict[str, Any]]:
    """Lag of every camera: the key ``video_lag`` of ``sync.json``."""
    if not episode.cameras:
        return {}
    origin, paths, problems = _paths(episode, segment)
    result = {}
    for camera in episode.cameras:
        try:
            video = episode.video(camera) if segment is None else segment.video(episode, camera)
            count = len(video.frames)

            def report(done: int, name: str = camera, count: int = count) -> None:
                if progress is not None:
                    progress(f"{name}: frame {done} of {count}")

            motion = image_motion.of_video(video.path, report)
            if segment is not None:
                first = int(video.frames["frame"][0])
                motion = motion.between(first, first + count)
            stamps = (video.frames["stamp_ns"] - origin) * 1e-9
            estimate = video_lag.estimate(stamps, motion, paths)
        except EpisodeError as problem:
            estimate = video_lag.LagEstimate(CANNOT_TELL, str(problem))
        if not paths and problems:
            estimate = dataclasses.replace(estimate, reason="; ".join(problems))
        result[camera] = _in_seconds(dataclasses.asdict(estimate))
    return result


def _paths(
    episode: Episode, segment: Segment | None
) -> tuple[int, dict[str, video_lag.TipPath], list[str]]:
    """Origin of time [ns], path of each arm's tip, and read errors."""
    paths, problems, origin = {}, [], 0

    def within(table: Table, name: str) -> Table:
        return table if segment is None else segment.table(table, name)

    wanted = ("stamp_ns", "receive_ns", "p_tip_x", "p_tip_y", "p_tip_z")
    for arm in episode.arms:
        try:
            table = table_file.read_table(episode.folder / f"cycle_{arm}.csv", wanted=wanted)
            table = within(table, f"cycle_{arm}")
            tip = table.vector("p_tip")
        except EpisodeError as problem:
            problems.append(str(problem))
            continue
        origin = origin or (int(table["stamp_ns"][0]) if len(table) else 0)
        if path := _tip_path(table["stamp_ns"] - origin, tip):
            paths[arm] = path
    if ASSISTANT_TABLE in episode.tables:
        with contextlib.suppress(EpisodeError):  # optional
            table = within(episode.table(ASSISTANT_TABLE), ASSISTANT_TABLE)
            yaw, pitch, insertion = (table[name] for name in ("yaw", "pitch", "insertion"))
            tip = virtual_tip(yaw, pitch, insertion)
            if path := _tip_path(table["stamp_ns"] - origin, tip):
                paths["assistant"] = path
    return origin, paths, problems


def _tip_path(ns: Stamps, p: Column) -> video_lag.TipPath | None:
    """Path of a tip over increasing times (N,) [ns], (N, 3) [m]; None if it is never known."""
    good = np.isfinite(p).all(axis=1)
    ns, p = ns[good], p[good]
    later = np.append(True, ns[1:] > np.maximum.accumulate(ns)[:-1])
    return video_lag.TipPath(ns[later] * 1e-9, p[later]) if np.sum(later) > 1 else None


def _in_seconds(entry: dict[str, Any]) -> dict[str, Any]:
    """Add the unit to the keys."""
    renamed = {"lag": "lag_s", "uncertainty": "uncertainty_s", "bound": "bound_s"}
    return {renamed.get(key, key): value for key, value in entry.items()}
