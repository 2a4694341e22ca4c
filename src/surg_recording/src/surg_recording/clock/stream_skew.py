"""Whether every sample of a stream has a sample of the reference stream at its stamp."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_recording.clock import clock_sync
from surg_recording.clock.clock_agreement import CLOCK_TABLE
from surg_recording.clock.clock_segments import Segment
from surg_recording.clock.verdict import CANNOT_TELL, FAIL, PASS
from surg_recording.episode import table_file
from surg_recording.episode.episode_reader import Episode
from surg_recording.recording_errors import EpisodeError

Stamps = npt.NDArray[np.int64]

SKEW_BOUND = 0.010
"""Largest 95th percentile of the distance to the reference stream [s]."""
FUTURE_BOUND = clock_sync.OFFSET_BOUND
"""Largest median distance of a stamp into the future [s]; beyond it the clock is ahead."""
_APART = ("events", CLOCK_TABLE)
"""Tables that are no streams: their stamps have no counterpart."""


@dataclasses.dataclass(frozen=True)
class Stream:
    """Stamps of one table or camera."""

    name: str
    stamp: Stamps
    receive: Stamps
    problem: str = ""
    periodic: bool = True
    """False: only the age of its samples is judged, as of commands and of topics of any type."""


def streams(episode: Episode, segment: Segment | None) -> list[Stream]:
    """The stamps of all tables and sidecars, or of those within a segment."""
    wanted = ("stamp_ns", "receive_ns")
    tables, videos = episode.manifest["tables"], episode.manifest["videos"]
    entries = {**tables, **(videos if segment is None else dict.fromkeys(episode.cameras))}
    result = []
    for name, entry in entries.items():
        if name in _APART:
            continue
        kinds = entry.get("kinds") if isinstance(entry, dict) else None
        try:
            if segment is not None and name not in tables:
                table = segment.video(episode, name).frames
            else:
                table = table_file.read_table(episode.folder / f"{name}.csv", kinds, wanted)
                table = table if segment is None else segment.table(table, name)
        except EpisodeError as problem:
            result.append(Stream(name, _NO_STAMPS, _NO_STAMPS, str(problem)))
            continue
        if not all(column in table and table[column].dtype == np.int64 for column in wanted):
            continue  # a topic whose messages have no stamp
        valid = table["stamp_ns"] > 0
        stamp, receive = table["stamp_ns"][valid], table["receive_ns"][valid]
        if len(stamp):
            periodic = not name.startswith(("command_", "topics/"))
            result.append(Stream(name, stamp, receive, "", periodic))
    return result


_NO_STAMPS: Stamps = np.zeros(0, dtype=np.int64)


def skew(streams: Sequence[Stream], wall_clock: bool) -> dict[str, Any]:
    """Distances between the stamps of the streams; ages at reception for wall-clock stamps."""
    reasons = [stream.problem for stream in streams if stream.problem]
    verdict = CANNOT_TELL if reasons else PASS
    periodic = [s for s in streams if s.periodic and len(s.stamp)]
    reference = max(periodic, key=lambda s: len(s.stamp), default=None)
    levels: dict[str, dict[str, Any]] = {}
    for stream in streams:
        if not len(stream.stamp):
            continue
        entry: dict[str, Any] = {"samples": len(stream.stamp), "skew_s": None, "age_s": None}
        if reference is not None and stream is not reference and stream.periodic:
            entry["skew_s"] = _levels(nearest_ns(stream.stamp, reference.stamp) * 1e-9)
            if entry["skew_s"]["p95"] > SKEW_BOUND:
                verdict = FAIL
                reasons.append(
                    f"{stream.name}: one sample in twenty is {entry['skew_s']['p95'] * 1e3:.1f} ms"
                    f" or more from any of {reference.name}"
                )
        if wall_clock:
            age = (stream.receive - stream.stamp) * 1e-9
            entry["age_s"] = _levels(age)
            if entry["age_s"]["p50"] < -FUTURE_BOUND:
                verdict = FAIL
                reasons.append(
                    f"{stream.name}: stamped {-entry['age_s']['p50'] * 1e3:.1f} ms after it was"
                    " received: the clock of its machine is ahead of the recorder's"
                )
        levels[stream.name] = entry
    skews = [entry["skew_s"] for entry in levels.values() if entry["skew_s"]]
    worst = {key: max((skew[key] for skew in skews), default=0.0) for key in _LEVELS}
    return {
        "verdict": verdict,
        "reasons": reasons,
        "reference": reference.name if reference else None,
        "skew_s": worst if skews else None,
        "streams": levels,
    }


def nearest_ns(stamps: Stamps, reference: Stamps) -> Stamps:
    """Distance of every stamp (N,) to the nearest one of the reference (M,), M > 0 [ns]."""
    ordered = np.sort(reference)
    after = np.searchsorted(ordered, stamps)
    above = ordered[np.minimum(after, len(ordered) - 1)]
    below = ordered[np.maximum(after - 1, 0)]
    return np.minimum(np.abs(above - stamps), np.abs(stamps - below))


_LEVELS = ("p50", "p95", "max")


def _levels(values: npt.NDArray[np.float64]) -> dict[str, float]:
    p50, p95 = np.percentile(values, [50, 95])
    return {"p50": float(p50), "p95": float(p95), "max": float(np.max(values))}
