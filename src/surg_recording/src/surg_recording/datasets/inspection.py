"""Inspects the manifest of a recording: can it be exported, and together with which others?

Nothing large is read here. ``sampling`` finds damaged files, gaps and stalls when it converts the
recording.
"""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording.calibration import calibration_record
from surg_recording.clock.clock_segments import Segment
from surg_recording.datasets.layout import Layout, layout_of, mapping, measured_cameras
from surg_recording.datasets.options import ExportOptions
from surg_recording.episode import episode_reader, integrity, same_recording
from surg_recording.episode.checked.checked_reading import segment_of
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.verdicts import ABORTED, CRASHED, NOT_JUDGED, Verdict, has_tag, verdict
from surg_recording.file_io import read_json
from surg_recording.recording_errors import EpisodeError

SUCCESS, RECOVERY, FAILURE = "success", "recovery", "failure"
"""Kinds of recordings; the last two get a split of their own."""

SYNC_REPORT = "sync.json"


@dataclasses.dataclass(frozen=True)
class LabelledStage:
    """A stage of a recording: from ``begin_ns`` until before ``end_ns`` [ns], in words."""

    text: str
    begin_ns: int
    end_ns: int | None


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A recording that may be exported."""

    folder: Path
    layout: Layout
    kind: str
    instruction: str
    stages: tuple[LabelledStage, ...]
    about: dict[str, Any]
    """Facts for the dataset's page: task, operator, setting, seed, dates, software."""
    segment: Segment | None = None
    """The exported segment of a recording whose clock was set; None: all of it."""
    verdict: Verdict = NOT_JUDGED
    remarks: tuple[str, ...] = ()
    """What a reader should be told: no hashes, verdicts that disagree."""


def mixture(candidates: Sequence[Candidate]) -> dict[str, str]:
    """Task, robots and instruments of recordings that do not all agree in them, in words."""
    found = {
        "task": [c.instruction for c in candidates],
        "robots": ["+".join(c.layout.robots) for c in candidates],
        "instruments": ["+".join(c.layout.instruments) for c in candidates],
    }
    counts = {name: Counter(values) for name, values in found.items()}
    return {
        name: ", ".join(f"{value} ({n})" for value, n in each.items())
        for name, each in counts.items()
        if len(each) > 1
    }


def common(candidates: Sequence[Candidate]) -> Layout:
    """The first recording's layout, with the robots and instruments of all."""
    robots = dict.fromkeys("+".join(c.layout.robots) for c in candidates)
    tools = dict.fromkeys("+".join(c.layout.instruments) for c in candidates)
    first = candidates[0].layout
    return dataclasses.replace(
        first,
        robots=first.robots if len(robots) == 1 else ("|".join(robots),),
        instruments=first.instruments if len(tools) == 1 else ("|".join(tools),),
    )


def inspect(folder: Path, options: ExportOptions) -> Candidate:
    """Judge a recording by its manifest; an EpisodeError states what would allow its export."""
    recorded = episode_reader.read(folder)
    manifest = recorded.manifest
    if not recorded.complete and not options.allow_incomplete:
        raise EpisodeError(
            f"{folder}: the recording is {manifest.get('outcome')}: {manifest.get('reason')};"
            " --allow incomplete exports what is there"
        )
    segment = segment_of(recorded)
    sync = _sync(recorded, segment)
    if sync and sync.get("verdict") == "fail" and not options.allow_unsynchronised:
        raise EpisodeError(
            f"{folder}: its sync report ({SYNC_REPORT}) says 'fail': pictures and motion may not"
            " belong together; --allow unsynchronised exports it anyway"
        )
    run, judged = mapping(manifest.get("run")), verdict(manifest)
    remarks = integrity.remarks(recorded)
    if options.cameras is None:
        remarks += [
            f"left out: {name}, values of {kind}"
            for name, kind in measured_cameras(recorded).items()
        ]
    if judged.disagreement:
        remarks.append(f"verdicts disagree, the first counts: {judged.disagreement}")
    return Candidate(
        folder=folder,
        layout=layout_of(recorded, options),
        kind=kind_of(manifest),
        instruction=options.instruction
        or str(run.get("instruction") or manifest.get("task") or run.get("motion") or "not stated"),
        stages=tuple(
            LabelledStage(str(s.get("text") or s.get("name")), int(s["begin_ns"]), s.get("end_ns"))
            for s in recorded.stages
            if isinstance(s.get("begin_ns"), int)
        ),
        about={
            **{key: manifest.get(key) for key in _FACTS},
            "setting": run.get("setting"),
            "software": mapping(manifest.get("versions")).get("software"),
            "simulated": bool(manifest.get("sim")),
            "identity": same_recording.identity(recorded),
            "calibration": calibration_record.of_manifest(folder, manifest, options.size),
            "sync": sync,
        },
        segment=segment,
        verdict=judged,
        remarks=tuple(remarks),
    )


_FACTS = ("task", "operator", "seed", "created", "mode", "clock")


def kind_of(manifest: Mapping[str, Any]) -> str:
    """Success, recovery or failure: by the verdict, then by the tag ``recovery``."""
    if verdict(manifest).outcome in (FAILURE, ABORTED, CRASHED):
        return FAILURE
    return RECOVERY if has_tag(manifest, RECOVERY) else SUCCESS


def _sync(recorded: Episode, segment: Segment | None) -> dict[str, Any] | None:
    """The recording's sync report, if readable; that of the segment after a clock step."""
    path = recorded.folder / SYNC_REPORT
    if not os.path.lexists(path):
        return None
    report = read_json(path)
    if not isinstance(report, dict):
        return None
    part = report.get("segment") if segment is not None else None
    return part if isinstance(part, dict) else report
