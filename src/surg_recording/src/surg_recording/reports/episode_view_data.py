"""The data of an episode's page: its streams, thinned out, on one time axis.

All times are integer nanoseconds since the first stamp. The sample and the frame at the cursor are
the last ones whose stamp is not later (``at_or_before``; ``at`` in ``episode_videos.js``).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.contract import STATE_NAMES
from surg_core.transforms import rotate_back
from surg_recording import metrics
from surg_recording.episode import integrity, table_file
from surg_recording.episode.checked.shaft_ends import COLUMNS, shaft_ends
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError
from surg_recording.reports import episode_events, episode_plan
from surg_recording.reports.figure_style import EXECUTED, TRUE
from surg_recording.video import video_embed

MAX_ROWS = 20_000
"""Samples kept of a table: 40 s at 500 Hz whole, more are thinned out and keep their extremes."""
VIDEO_BUDGET = 64 << 20
"""Size of all videos of a page together [bytes]."""


Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Progress = Callable[[str], None]

_CYCLE = (
    *("stamp_ns", "receive_ns", "tick", "state", "homed", "depth"),
    *(f"{name}_{axis}" for name in ("p_tip", "s", "p_rcm") for axis in "xyz"),
    *(f"q_br_{axis}" for axis in "xyzw"),
)
_TRUTH = (
    "stamp_ns",
    *(f"{name}_{axis}" for name in ("shaft", "axis", "trocar", "force") for axis in "xyz"),
)


@dataclasses.dataclass(frozen=True)
class Viewed:
    """The data of a page, ready for JSON; ``missing`` states what it cannot show, and why."""

    data: dict[str, Any]
    videos: list[bytes]
    missing: list[str]


def kept_rows(curves: Sequence[Array], limit: int = MAX_ROWS) -> npt.NDArray[np.int64]:
    """Indices of about ``limit`` rows to show of curves (N,), NaN where unknown.

    Beyond the limit: the first and the last row, and from equal intervals the rows with the least
    and the greatest value of each curve, so that no extreme is lost.
    """
    count = len(curves[0])
    if count <= limit:
        return np.arange(count)
    edges = np.linspace(0, count, max(1, limit // (2 * len(curves))) + 1).astype(np.int64)
    kept = {0, count - 1}
    for values in curves:
        for sign in (1.0, -1.0):
            low = np.where(np.isnan(values), np.inf, sign * values)
            for start, stop in itertools.pairwise(edges):
                if stop > start:
                    kept.add(int(start + np.argmin(low[start:stop])))
    return np.array(sorted(kept), dtype=np.int64)


def collect(
    episode: Episode,
    budget: int = VIDEO_BUDGET,
    max_rows: int = MAX_ROWS,
    progress: Progress | None = None,
) -> Viewed:
    """Gather what the page shows; an EpisodeError if that is nothing. States what is missing.

    ``budget`` is the size of all videos together [bytes], ``max_rows`` the samples per table.
    """
    say = progress or (lambda _: None)
    missing: list[str] = []
    tables: dict[str, Table] = {}
    for arm in episode.arms:
        say(f"reading {arm}")
        stated = episode.manifest["tables"].get(f"cycle_{arm}", {}).get("columns", ())
        wanted = [*_CYCLE, *(name for name in COLUMNS if name in stated)]
        table = _read(episode, f"cycle_{arm}", wanted, missing)
        if table is not None:
            tables[arm] = table
    videos = _videos(episode, budget, say, missing)
    firsts = [int(table["stamp_ns"][0]) for table in tables.values()]
    lasts = [int(table["stamp_ns"][-1]) for table in tables.values()]
    firsts += [int(stamps[0]) for _, stamps, _ in videos]
    lasts += [int(stamps[-1]) for _, stamps, _ in videos]
    if not firsts:
        raise EpisodeError(f"{episode.folder}: nothing to show: {'; '.join(missing)}")
    origin, end = min(firsts), max(lasts)
    arms = [_arm(episode, arm, table, origin, max_rows, missing) for arm, table in tables.items()]
    missing += [text for text in integrity.changes(episode) if text not in missing]
    missing += integrity.remarks(episode)
    clock = next(iter(tables.values()), None)
    events = episode_events.collect(episode, origin, end, clock, missing)
    data = {
        "origin_ns": str(origin),
        "duration": end - origin,
        "arms": arms,
        "videos": [
            {
                "name": name,
                "stamps": (stamps - origin).tolist(),
                "pts": shown.pts.tolist(),
                "frames": shown.frames.tolist(),
                "note": shown.note,
            }
            for name, stamps, shown in videos
        ],
        "events": events,
        "plans": episode_plan.collect(episode, origin, missing),
        "states": STATE_NAMES,
    }
    return Viewed(data, [shown.data for _, _, shown in videos], missing)


# --- an arm -------------------------------------------------------------------------------------


def _arm(
    episode: Episode, arm: str, cycle: Table, origin: int, limit: int, missing: list[str]
) -> dict[str, Any]:
    """Path and curves of one arm, thinned out."""
    tip, pivot = cycle.vector("p_tip"), cycle.vector("p_rcm")
    deviation = metrics.rcm_deviation(shaft_ends(cycle), cycle.vector("s"), pivot)
    in_rcm = rotate_back(cycle.vector("q_br", "xyzw"), tip - pivot)
    in_rcm[cycle["homed"] == 0] = np.nan  # there is no rcm frame before
    depth = cycle["depth"]
    rows = kept_rows([deviation, depth, *in_rcm.T], limit)
    curves = [_curve("Depth", "mm", [_series("depth", EXECUTED, "cycle", depth[rows] * 1e3, 3)])]
    rcm = [_series("kinematic", EXECUTED, "cycle", deviation[rows] * 1e3, 5)]
    curves.append(_curve("RCM deviation", "mm", rcm))
    clocks = {"cycle": (cycle["stamp_ns"][rows] - origin).tolist()}
    if f"ground_truth_{arm}" not in episode.tables:
        reason = "it was recorded without the simulator's ground truth"
        missing.append(f"{arm}: no force and no true RCM deviation: {reason}")
    elif (truth := _read(episode, f"ground_truth_{arm}", _TRUTH, missing)) is not None:
        true = metrics.rcm_deviation(
            truth.vector("shaft"), truth.vector("axis"), truth.vector("trocar")
        )
        force = np.linalg.norm(truth.vector("force"), axis=1)
        kept = kept_rows([true, force], limit)
        clocks["truth"] = (truth["stamp_ns"][kept] - origin).tolist()
        rcm.insert(0, _series("true", TRUE, "truth", true[kept] * 1e3, 5))
        series = [_series("force on the trocar", TRUE, "truth", force[kept], 4)]
        curves.append(_curve("Force on the trocar", "N", series))
    commands = episode.manifest["tables"].get(f"command_{arm}") or {}
    # An arm that nobody commanded was not meant to move.
    if not np.any(np.isfinite(in_rcm)) and commands.get("rows") != 0:
        missing.append(f"{arm}: no tip path: the arm was never homed")
    return {
        "name": arm,
        "clocks": clocks,
        "rows": rows.tolist() if len(rows) < len(cycle) else None,
        "total": len(cycle),
        "tick": cycle["tick"][rows].tolist(),
        "state": cycle["state"][rows].tolist(),
        "path": [_numbers(values[rows] * 1e3, 3) for values in in_rcm.T],
        "curves": curves,
    }


def _curve(title: str, unit: str, series: list[dict[str, Any]]) -> dict[str, Any]:
    return {"title": title, "unit": unit, "series": series}


def _series(name: str, colour: str, clock: str, values: Array, digits: int) -> dict[str, Any]:
    return {"name": name, "colour": colour, "clock": clock, "values": _numbers(values, digits)}


def _numbers(values: Array, digits: int) -> list[float | None]:
    """Rounded for the page; None for a non-finite number."""
    return [round(v, digits) if math.isfinite(v) else None for v in values.tolist()]


def _read(episode: Episode, name: str, wanted: Sequence[str], missing: list[str]) -> Table | None:
    """A table with at least one row; else None, and the reason in ``missing``."""
    if name not in episode.tables:
        missing.append(f"{name}: nothing was recorded")
        return None
    try:
        table = table_file.read_table(episode.folder / f"{name}.csv", wanted=wanted)
        lacking = [column for column in wanted if column not in table]
        if lacking:
            raise EpisodeError(f"{name}: no column {', '.join(lacking)}")
    except EpisodeError as problem:
        missing.append(str(problem))
        return None
    if not len(table):
        missing.append(f"{name}: no rows were recorded")
        return None
    return table


# --- videos -------------------------------------------------------------------------------------


def _videos(
    episode: Episode, budget: int, say: Progress, missing: list[str]
) -> list[tuple[str, Stamps, video_embed.Embedded]]:
    """Name, stamps [ns] and file of every camera that can be shown."""
    videos = []
    if not episode.cameras:
        missing.append("no video: it was recorded without a camera")
    for camera in episode.cameras:
        say(f"{camera}: making the video fit")

        def report(count: int, name: str = camera) -> None:
            say(f"{name}: frame {count}")

        try:
            video = episode.video(camera)
            shown = video_embed.embed(video.path, budget // len(episode.cameras), report)
            inside = shown.frames < len(video.frames)
            if not np.any(inside):
                raise EpisodeError(f"{camera}: no frame of the video has a stamp")
        except EpisodeError as problem:
            missing.append(str(problem))
            continue
        shown = dataclasses.replace(shown, frames=shown.frames[inside], pts=shown.pts[inside])
        videos.append((camera, video.frames["stamp_ns"][shown.frames], shown))
    return videos
