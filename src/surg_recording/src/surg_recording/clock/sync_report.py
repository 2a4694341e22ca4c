"""Do the streams of an episode belong to one time? ``sync.json``, and the mark in the manifest.

Three questions, each answered ``pass``, ``fail`` or ``cannot_tell`` with reasons:

* *clock*: did the machines' clocks agree while it was recorded (``clock_sync.csv``)?
* *skew*: does every sample of a stream have a sample of the reference stream at its stamp, and do
  stamps lie in the past when they are received?
* *video lag*: does a video show what the kinematics say, at the time they say it?

Where the clock was set meanwhile (free-run), the first answer is ``fail``; the other two are of the
longest stretch between its steps, whose own verdict stands under ``segment``.

On the command line: ``python -m surg_recording.clock.sync_report EPISODE…``.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.transforms import virtual_tip
from surg_recording.clock import clock_segments, clock_sync
from surg_recording.clock.clock_segments import Segment
from surg_recording.episode import episode_reader as episodes
from surg_recording.episode.episode_reader import MANIFEST, Episode, Table
from surg_recording.episode.finishing import clean_json, write_json
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import image_motion, video_lag
from surg_recording.video.video_lag import CANNOT_TELL, FAIL, PASS

FILE = "sync.json"
CLOCK_TABLE = "clock_sync"
"""Table that the recorder writes what the clock monitor says into."""

SKEW_BOUND = 0.010
"""A stream whose samples are further from the reference at the 95th percentile does not fit [s]."""
FUTURE_BOUND = clock_sync.OFFSET_BOUND
"""A stream whose median stamp lies this far in the future comes from a clock that is ahead [s]."""
SILENCE_BOUND = 5.0
"""Without a word of the clock for longer than this, nothing is known of it [s]."""

_APART = ("events", CLOCK_TABLE)
"""Tables that are no streams: their stamps have no partner to look for."""

ASSISTANT_TABLE = "command_assistant"
"""The assistant's instrument, which no controller measures: its commands stand for its motion."""

Stamps = npt.NDArray[np.int64]
Column = npt.NDArray[np.float64]
Progress = Callable[[str], None]


def make(episode: Episode, progress: Progress | None = None) -> dict[str, Any]:
    """Examine an episode.

    Args:
        episode: a finished one, of any version.
        progress: told in a few words what is being done.

    Returns:
        What ``sync.json`` holds; docs/guide/clock_sync.md lists the keys. A part that cannot be
        read is
        named under ``reasons`` and makes the verdict ``cannot_tell``; it never raises for that.
    """
    segment, stepped = _steps(episode.manifest)
    unset = _clock(episode)
    clock = unset
    if stepped:
        others = unset["reasons"] if unset["verdict"] != PASS else []
        clock = _clock_failed(unset, *stepped, *others)
    skew = _skew(_streams(episode, segment), wall_clock=episode.manifest.get("mode") == "freerun")
    lags = _lags(episode, segment, progress)
    rest = [(skew["verdict"], skew["reasons"])]
    rest += [(lag["verdict"], [f"{name}: {lag['reason']}"]) for name, lag in lags.items()]
    result = {
        **_together([(clock["verdict"], clock["reasons"]), *rest]),
        "offset_s": clock["offset_s"],
        "path_delay_s": clock["path_delay_s"],
        "grandmaster": clock["grandmaster"],
        "clock": clock,
        "skew_s": skew["skew_s"],
        "streams": skew["streams"],
        "reference": skew["reference"],
        "video_lag": lags,
        "bounds": {
            "offset_s": clock_sync.OFFSET_BOUND,
            "skew_p95_s": SKEW_BOUND,
            "future_s": FUTURE_BOUND,
        },
    }
    if segment is not None:
        alone = _together([(unset["verdict"], unset["reasons"]), *rest])
        result["segment"] = {"said": segment.words, "seconds": segment.seconds, **alone}
    return dict(clean_json(result))


def _together(parts: Sequence[tuple[str, list[str]]]) -> dict[str, Any]:
    """The worst of several verdicts, and the reasons of all that did not pass."""
    verdict = _worst([found for found, _ in parts])
    return {
        "verdict": verdict,
        "reasons": [reason for found, said in parts if found != PASS for reason in said],
    }


def _steps(manifest: Mapping[str, Any]) -> tuple[Segment | None, list[str]]:
    """The longest stretch between the steps of the clock, and the steps in words."""
    if manifest.get("mode") == "lockstep":
        return None, []
    said = [
        f"the wall clock was set by {step.get('step_ns', 0) * 1e-9:+.3f} s while it was recorded"
        for step in manifest.get("segments") or []
        if isinstance(step, dict)
    ]
    try:
        return clock_segments.longest(manifest), said
    except EpisodeError as problem:
        return None, [*said, str(problem)]


def write(folder: Path | str, progress: Progress | None = None) -> dict[str, Any]:
    """Examine an episode, write ``sync.json`` and mark the manifest; returns what was found.

    The manifest receives the key ``sync`` with verdict and reasons; nothing else in it changes.

    Raises:
        EpisodeError: no readable episode, or the folder cannot be written.
    """
    episode = episodes.read(folder)
    result = make(episode, progress)
    mark = {"verdict": result["verdict"], "reasons": result["reasons"]}
    try:
        write_json(episode.folder / FILE, result)
        write_json(episode.folder / MANIFEST, {**episode.manifest, "sync": mark})
    except OSError as problem:
        raise EpisodeError(f"{folder}: cannot write {FILE}: {problem.strerror}") from problem
    return result


def ensure(episode: Episode, progress: Progress | None = None) -> dict[str, Any]:
    """The report of an episode: the one on disk, else made now and written when that is possible.

    Raises:
        EpisodeError: the manifest has gone meanwhile.
    """
    found = load(episode)
    if found is not None:
        return found
    try:
        return write(episode.folder, progress)
    except EpisodeError:
        return make(episode, progress)  # a folder that may only be read


def load(episode: Episode) -> dict[str, Any] | None:
    """What ``sync.json`` says, or None where there is none that can be read."""
    try:
        found = json.loads((episode.folder / FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and "verdict" in found else None


def machines(manifest: Any) -> int:
    """How many machines' clocks have stamped an episode, by its manifest.

    ``run.machines`` says it (a number, or a list of their names); else a cell that allows ROS on an
    isolated network is one of two machines, any other of one.
    """
    stated = (manifest.get("run") or {}).get("machines")
    if isinstance(stated, list) and stated:
        return len(stated)
    if isinstance(stated, int) and stated > 0:
        return stated
    return 2 if (manifest.get("cell") or {}).get("network") == "isolated" else 1


# --- the clock ----------------------------------------------------------------------------------


def _clock(episode: Episode) -> dict[str, Any]:
    """Whether the machines' clocks agreed, but for steps of the recorder's own."""
    result: dict[str, Any] = {
        "verdict": PASS,
        "reasons": [],
        "machines": machines(episode.manifest),
        "samples": 0,
        "offset_s": None,
        "offset_median_s": None,
        "path_delay_s": None,
        "grandmaster": None,
        "port_states": [],
    }
    if episode.manifest.get("mode") == "lockstep":
        return {**result, "reasons": ["lock-step: all stamps are the simulator's ticks"]}
    several = result["machines"] > 1
    if CLOCK_TABLE not in episode.tables:
        if several:
            return _clock_failed(result, "two machines, but no clock was monitored")
        return {**result, "reasons": ["one machine, one clock"]}
    try:
        table = episode.table(CLOCK_TABLE)
    except EpisodeError as problem:
        return {**result, "verdict": CANNOT_TELL, "reasons": [str(problem)]}
    result["samples"] = len(table)
    result["port_states"] = sorted(set(table["port_state"]) - {""})
    masters = sorted(set(table["grandmaster"]) - {""})
    result["grandmaster"] = masters[0] if len(masters) == 1 else (masters or None)
    followers = table["port_state"] != clock_sync.MASTER
    offset, delay = table["offset_s"][followers], table["path_delay_s"][followers]
    measured = np.isfinite(offset)
    if np.any(measured):
        offset = offset[measured]
        result["offset_s"] = float(offset[np.argmax(np.abs(offset))])
        result["offset_median_s"] = float(np.median(offset))
    if np.any(np.isfinite(delay)):
        result["path_delay_s"] = float(np.nanmedian(delay))
    faults = _clock_faults(table, several)
    if several and not np.any(followers):
        faults.append(
            "two machines, but only the master's clock was monitored: run the monitor on the other"
        )
    if several:
        silent = _longest_silence(episode, table)
        if silent > SILENCE_BOUND:
            faults.append(f"nothing is known of the clocks for {silent:.0f} s")
    if several and len(masters) > 1:
        faults.append(f"the grandmaster changed: {', '.join(masters)}")
    return _clock_failed(result, *faults) if faults else result


def _clock_faults(table: Table, several: bool) -> list[str]:
    """Every distinct kind of fault once, with how often it was seen and its worst case.

    On one machine a missing master does no harm; an offset out of bounds is told all the same.
    """
    worst: dict[str, tuple[int, float, str]] = {}
    for state, offset, delay, master, problem in zip(
        *(table[c] for c in ("port_state", "offset_s", "path_delay_s", "grandmaster", "problem")),
        strict=True,
    ):
        status = clock_sync.ClockStatus(state, offset, delay, master, "", problem)
        fault = status.fault()
        far = abs(offset) > clock_sync.OFFSET_BOUND
        if not fault or not (several or far):
            continue
        kind = "offset" if far else fault
        count, size, text = worst.get(kind, (0, -1.0, ""))
        size_now = abs(offset) if far else 0.0
        worst[kind] = (count + 1, max(size, size_now), fault if size_now > size else text)
    return [f"{text} ({count} of {len(table)} looks)" for count, _, text in worst.values()]


def _longest_silence(episode: Episode, table: Table) -> float:
    """Longest time without a look at the clock, the ends of the episode included [s]."""
    times = np.sort(table["receive_ns"])
    start, stop = (episode.manifest.get(key) for key in ("started_ns", "stopped_ns"))
    ends = [int(t) for t in (start, stop) if isinstance(t, int)]
    return float(np.max(np.diff(np.sort(np.append(times, ends))), initial=0)) * 1e-9


def _clock_failed(result: dict[str, Any], *reasons: str) -> dict[str, Any]:
    return {**result, "verdict": FAIL, "reasons": list(reasons)}


# --- skew ---------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Stream:
    name: str
    stamp: Stamps
    receive: Stamps
    problem: str = ""
    periodic: bool = True
    """False: only its age is looked at, as of commands, which come when they come, and of topics
    of any kind, which may have stamps of their own."""


def _streams(episode: Episode, segment: Segment | None) -> list[_Stream]:
    """The stamps of all tables and sidecars, or of those within a segment."""
    wanted = ("stamp_ns", "receive_ns")
    tables, videos = episode.manifest["tables"], episode.manifest["videos"]
    entries = {**tables, **(videos if segment is None else dict.fromkeys(episode.cameras))}
    found = []
    for name, entry in entries.items():
        if name in _APART:
            continue
        kinds = entry.get("kinds") if isinstance(entry, dict) else None
        try:
            if segment is not None and name not in tables:
                table = segment.video(episode, name).frames
            else:
                table = episodes.read_table(episode.folder / f"{name}.csv", kinds, wanted)
                table = table if segment is None else segment.table(table, name)
        except EpisodeError as problem:
            found.append(_Stream(name, _NONE, _NONE, str(problem)))
            continue
        if not all(column in table and table[column].dtype == np.int64 for column in wanted):
            continue  # a topic whose messages bear no stamp
        valid = table["stamp_ns"] > 0
        stamp, receive = table["stamp_ns"][valid], table["receive_ns"][valid]
        if len(stamp):
            periodic = not name.startswith(("command_", "topics/"))
            found.append(_Stream(name, stamp, receive, "", periodic))
    return found


_NONE: Stamps = np.zeros(0, dtype=np.int64)


def _skew(streams: Sequence[_Stream], wall_clock: bool) -> dict[str, Any]:
    """Distances between the stamps of the streams, and their ages at reception."""
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
    """Distance of every stamp to the nearest one of the reference, exact integers [ns].

    Args:
        stamps: (N,) in any order.
        reference: (M,) with M > 0, in any order.
    """
    ordered = np.sort(reference)
    after = np.searchsorted(ordered, stamps)
    above = ordered[np.minimum(after, len(ordered) - 1)]
    below = ordered[np.maximum(after - 1, 0)]
    return np.minimum(np.abs(above - stamps), np.abs(stamps - below))


_LEVELS = ("p50", "p95", "max")


def _levels(values: npt.NDArray[np.float64]) -> dict[str, float]:
    p50, p95 = np.percentile(values, [50, 95])
    return {"p50": float(p50), "p95": float(p95), "max": float(np.max(values))}


# --- video against kinematics -------------------------------------------------------------------


def _lags(
    episode: Episode, segment: Segment | None, progress: Progress | None
) -> dict[str, dict[str, Any]]:
    """The lag of every camera."""
    if not episode.cameras:
        return {}
    origin, paths, problems = _paths(episode, segment)
    result = {}
    for camera in episode.cameras:
        try:
            video = episode.video(camera) if segment is None else segment.video(episode, camera)
            count = len(video.frames)

            def told(done: int, name: str = camera, count: int = count) -> None:
                if progress is not None:
                    progress(f"{name}: frame {done} of {count}")

            motion = image_motion.of_video(video.path, told)
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
    """Origin of time [ns], the tips' paths by arm, and what could not be read."""
    paths, problems, origin = {}, [], 0

    def within(table: Table, name: str) -> Table:
        return table if segment is None else segment.table(table, name)

    for arm in episode.arms:
        try:
            table = episodes.read_table(
                episode.folder / f"cycle_{arm}.csv",
                wanted=("stamp_ns", "receive_ns", "p_tip_x", "p_tip_y", "p_tip_z"),
            )
            table = within(table, f"cycle_{arm}")
            tip = table.vector("p_tip")
        except EpisodeError as problem:
            problems.append(str(problem))
            continue
        origin = origin or (int(table["stamp_ns"][0]) if len(table) else 0)
        path = _tip_path(table["stamp_ns"] - origin, tip)
        if path is not None:
            paths[arm] = path
    if ASSISTANT_TABLE in episode.tables:
        with contextlib.suppress(EpisodeError):  # it only helps
            table = within(episode.table(ASSISTANT_TABLE), ASSISTANT_TABLE)
            yaw, pitch, insertion = (table[name] for name in ("yaw", "pitch", "insertion"))
            tip = virtual_tip(yaw, pitch, insertion)
            path = _tip_path(table["stamp_ns"] - origin, tip)
            if path is not None:
                paths["assistant"] = path
    return origin, paths, problems


def _tip_path(ns: Stamps, p: Column) -> video_lag.TipPath | None:
    """A tip against increasing times; None where it is never known.

    Args:
        ns: (N,) times [ns]; rows that do not come later than all before are left out.
        p: (N, 3) [m], NaN where nothing is known.
    """
    good = np.isfinite(p).all(axis=1)
    ns, p = ns[good], p[good]
    later = np.append(True, ns[1:] > np.maximum.accumulate(ns)[:-1])
    return video_lag.TipPath(ns[later] * 1e-9, p[later]) if np.sum(later) > 1 else None


def _in_seconds(entry: dict[str, Any]) -> dict[str, Any]:
    """Keys with their unit, as everywhere in files."""
    renamed = {"lag": "lag_s", "uncertainty": "uncertainty_s", "bound": "bound_s"}
    return {renamed.get(key, key): value for key, value in entry.items()}


def _worst(verdicts: Sequence[str]) -> str:
    """One failure fails all; else one doubt is a doubt."""
    for verdict in (FAIL, CANNOT_TELL):
        if verdict in verdicts:
            return verdict
    return PASS


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; exit code 0: all pass, 1: a failure, 2: no readable episode."""
    parser = argparse.ArgumentParser(
        prog="python -m surg_recording.clock.sync_report",
        description="Examine the synchronisation of episodes; write sync.json and mark manifests.",
    )
    parser.add_argument("episodes", nargs="+", type=Path, metavar="EPISODE")
    parser.add_argument("--quiet", action="store_true", help="print problems only")
    given = parser.parse_args(arguments)
    code = 0
    for folder in given.episodes:
        try:
            result = write(folder)
        except EpisodeError as problem:
            print(f"sync_report: {problem}", file=sys.stderr)
            code = 2
            continue
        if not given.quiet:
            print("\n  ".join([f"{folder}: {result['verdict']}", *result["reasons"]]))
        if result["verdict"] == FAIL and code == 0:
            code = 1
    return code


if __name__ == "__main__":
    sys.exit(main())
