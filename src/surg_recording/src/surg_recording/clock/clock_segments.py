"""The segments of a recording between the steps of its clock (free-run).

Stamps before and after a step cannot be compared, so whoever needs one time for all streams uses
the longest segment. What lies within ``GUARD_NS`` of a step is excluded, because a message may be
stamped before the step and received after it. In lock-step the stamps are the simulator's ticks
and no step matters.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table, Video
from surg_recording.recording_errors import EpisodeError

GUARD_NS = 1_000_000_000
"""Excluded on either side of a step [ns]."""

EDGE = 2
"""Rows excluded on either side of a step: the recorder's counts of rows may be off by one."""

Mask = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Segment:
    """One segment."""

    number: int
    count: int
    begin_ns: int | None
    """Start by the recorder's clock [ns]; None: the recording's start."""
    end_ns: int | None
    """End [ns]; None: the recording's end."""
    seconds: float
    """Length [s]."""
    before: Mapping[str, int]
    """Per table and camera: rows and frames received before it."""
    until: Mapping[str, int] | None
    """The same before its end; None: the recording's end."""

    @property
    def words(self) -> str:
        """The segment in words."""
        return (
            f"the clock was set {self.count - 1} times while it was recorded: of its"
            f" {self.count} segments number {self.number}, the longest ({self.seconds:.1f} s)"
        )

    def rows(self, name: str, receive_ns: npt.NDArray[np.int64], lost: Any = 0) -> Mask:
        """Mask (N,) of the rows of a table, or frames of a camera, within the segment.

        ``receive_ns`` (N,) is their reception by the recorder's clock [ns]; ``lost``, a number or
        (N,), counts those received before each but not written.
        """
        place = np.arange(len(receive_ns)) + lost
        inside = np.ones(len(receive_ns), dtype=bool)
        if self.begin_ns is not None:
            inside &= (place >= self.before.get(name, 0) + EDGE) & (receive_ns >= self.begin_ns)
        if self.until is not None and self.end_ns is not None:
            inside &= (place < self.until.get(name, 0) - EDGE) & (receive_ns <= self.end_ns)
        return inside

    def table(self, table: Table, name: str) -> Table:
        """The rows of a table within the segment."""
        return table.select(np.flatnonzero(self.rows(name, table["receive_ns"])))

    def video(self, recorded: Episode, camera: str) -> Video:
        """The video of a camera with the lines of its sidecar within the segment.

        Raises:
            EpisodeError: The segment has no frame of the camera, or frames in several files.
        """
        parts, before = [], 0
        for video in recorded.parts(camera):
            lost = video.frames["dropped"]
            inside = self.rows(camera, video.frames["receive_ns"], before + np.cumsum(lost))
            before += len(video.frames) + int(lost.sum())
            if inside.any():
                frames = video.frames.select(np.flatnonzero(inside))
                parts.append(dataclasses.replace(video, frames=frames))
        if len(parts) != 1:
            what = "more than one video" if parts else "no frame"
            raise EpisodeError(f"{recorded.folder}: {camera} has {what} in it; {self.words}")
        return parts[0]


def longest(manifest: Mapping[str, Any]) -> Segment | None:
    """The longest segment between the steps of a recording's clock; None without a step.

    Raises:
        EpisodeError: The steps are not as the recorder writes them, or no segment is left.
    """
    steps = manifest.get("segments") or []
    if not steps or manifest.get("mode") == "lockstep":
        return None
    try:
        times = [(int(step["begin_ns"]), int(step["step_ns"])) for step in steps]
        counts = [{**dict(step["rows"]), **dict(step["frames"])} for step in steps]
        begins = [int(manifest["started_ns"]), *(begin + GUARD_NS for begin, _ in times)]
        ends = [begin - step - GUARD_NS for begin, step in times]
        ends.append(int(manifest["stopped_ns"]))
    except (KeyError, TypeError, ValueError) as problem:
        raise EpisodeError(
            f"the clock was set {len(steps)} times while it was recorded (key 'segments' of the"
            f" manifest), and it is not known which rows lie on which side ({problem!r}): it was"
            " killed, or the manifest edited; its stamps cannot be compared"
        ) from None
    lengths = [end - begin for begin, end in zip(begins, ends, strict=True)]
    best = int(np.argmax(lengths))
    if lengths[best] <= 0:
        raise EpisodeError(
            f"the clock was set {len(steps)} times while it was recorded, and no segment between"
            f" is longer than {2e-9 * GUARD_NS:g} s"
        )
    last = len(steps)
    return Segment(
        number=best + 1,
        count=last + 1,
        begin_ns=begins[best] if best else None,
        end_ns=ends[best] if best < last else None,
        seconds=lengths[best] * 1e-9,
        before=counts[best - 1] if best else {},
        until=counts[best] if best < last else None,
    )
