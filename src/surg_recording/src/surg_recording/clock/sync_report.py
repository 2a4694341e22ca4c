"""Judges whether the streams of an episode share one time: ``sync.json``, and a manifest entry.

Three questions, each answered ``pass``, ``fail`` or ``cannot_tell`` with reasons:

* ``clock_agreement``: did the machines' clocks agree?
* ``stream_skew``: does every sample of a stream have a sample of the reference stream at its stamp,
  and are stamps in the past when they are received?
* ``camera_lag``: does a video show what the kinematics state for the same time?

If the clock was set during a free-run recording, the first answer is ``fail``. The other two then
cover the longest segment between clock steps, whose own verdict is under ``segment``.

Command line: ``python -m surg_recording.clock.sync_report EPISODE…``.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording.clock import (
    camera_lag,
    clock_agreement,
    clock_segments,
    clock_sync,
    stream_skew,
)
from surg_recording.clock.camera_lag import Progress
from surg_recording.clock.clock_segments import Segment
from surg_recording.clock.verdict import FAIL, PASS, worst
from surg_recording.episode import episode_reader as episodes
from surg_recording.episode.episode_reader import MANIFEST, Episode
from surg_recording.episode.finishing import clean_json, write_json
from surg_recording.file_io import read_json
from surg_recording.recording_errors import EpisodeError

FILE = "sync.json"


def make(episode: Episode, progress: Progress | None = None) -> dict[str, Any]:
    """Content of ``sync.json`` of a finished episode; docs/guide/clock_sync.md lists the keys.

    A part that cannot be read is named under ``reasons`` and makes the verdict ``cannot_tell``.
    ``progress`` is called with a short text about the current step.
    """
    segment, stepped = _steps(episode.manifest)
    unset = clock_agreement.agreement(episode)
    clock = unset
    if stepped:
        others = unset["reasons"] if unset["verdict"] != PASS else []
        clock = clock_agreement.failed(unset, *stepped, *others)
    free_run = episode.manifest.get("mode") == "freerun"
    skew = stream_skew.skew(stream_skew.streams(episode, segment), wall_clock=free_run)
    lags = camera_lag.lags(episode, segment, progress)
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
            "skew_p95_s": stream_skew.SKEW_BOUND,
            "future_s": stream_skew.FUTURE_BOUND,
        },
    }
    if segment is not None:
        alone = _together([(unset["verdict"], unset["reasons"]), *rest])
        result["segment"] = {"said": segment.words, "seconds": segment.seconds, **alone}
    return dict(clean_json(result))


def _together(parts: Sequence[tuple[str, list[str]]]) -> dict[str, Any]:
    """The worst of several verdicts, and the reasons of all that did not pass."""
    return {
        "verdict": worst([verdict for verdict, _ in parts]),
        "reasons": [reason for verdict, reasons in parts if verdict != PASS for reason in reasons],
    }


def _steps(manifest: Mapping[str, Any]) -> tuple[Segment | None, list[str]]:
    """Longest segment between steps of the clock, and a sentence per step."""
    if manifest.get("mode") == "lockstep":
        return None, []
    steps = [
        f"the wall clock was set by {step.get('step_ns', 0) * 1e-9:+.3f} s while it was recorded"
        for step in manifest.get("segments") or []
        if isinstance(step, dict)
    ]
    try:
        return clock_segments.longest(manifest), steps
    except EpisodeError as problem:
        return None, [*steps, str(problem)]


def write(folder: Path | str, progress: Progress | None = None) -> dict[str, Any]:
    """Examine an episode and write ``sync.json``; an EpisodeError if that is impossible.

    The manifest receives the key ``sync`` with verdict and reasons; nothing else in it changes.
    """
    episode = episodes.read(folder)
    result = make(episode, progress)
    mark = {"verdict": result["verdict"], "reasons": result["reasons"]}
    try:
        write_json(episode.folder / FILE, result)
        write_json(episode.folder / MANIFEST, {**episode.as_recorded, "sync": mark})
    except OSError as problem:
        raise EpisodeError(f"{folder}: cannot write {FILE}: {problem.strerror}") from problem
    return result


def ensure(episode: Episode, progress: Progress | None = None) -> dict[str, Any]:
    """The report of an episode: from disk, or made now and written if possible."""
    known = load(episode)
    if known is not None:
        return known
    if os.path.lexists(episode.folder / FILE):
        return make(episode, progress)  # something else lies there: it is left alone
    try:
        return write(episode.folder, progress)
    except EpisodeError:
        return make(episode, progress)  # a read-only folder


def load(episode: Episode) -> dict[str, Any] | None:
    """Content of ``sync.json``; None if there is none that can be read."""
    try:
        content = read_json(episode.folder / FILE)
    except EpisodeError:
        return None
    if not isinstance(content, dict) or not isinstance(content.get("verdict"), str):
        return None
    reasons = content.get("reasons") or []
    right = isinstance(reasons, list) and all(isinstance(reason, str) for reason in reasons)
    return content if right else None


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; exit code 0: no failure, 1: a failure, 2: no readable episode."""
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
