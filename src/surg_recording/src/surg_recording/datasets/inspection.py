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

from surg_core.contract import FORCE_KEY, TASK_STATE_KEY
from surg_core.force.observed_force import PLACES
from surg_recording.calibration import calibration_record
from surg_recording.clock.clock_segments import Segment
from surg_recording.datasets import pictures, schema
from surg_recording.datasets.options import ExportOptions
from surg_recording.episode import episode_reader, integrity, same_recording, table_columns
from surg_recording.episode.checked_reading import segment_of
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.verdicts import NOT_JUDGED, Verdict, has_tag, verdict
from surg_recording.file_io import read_json
from surg_recording.recording_errors import EpisodeError
from surg_recording.video.video_encoder import ENCODINGS

SUCCESS, RECOVERY, FAILURE = "success", "recovery", "failure"
"""Kinds of recordings; the last two get a split of their own."""

SYNC_REPORT = "sync.json"


@dataclasses.dataclass(frozen=True)
class Layout:
    """Properties that all recordings of one export share."""

    arms: tuple[str, ...]
    robots: tuple[str, ...]
    joints: tuple[int, ...]
    instruments: tuple[str, ...]
    commanded: tuple[str, ...]
    """Arms that received motion commands."""
    cameras: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    """Width and height of each camera [px]."""
    labelled: bool
    task_numbers: tuple[str, ...]
    """Columns of the task's ground truth."""
    truth: bool
    forces: bool = False
    """Whether a force at tip or trocar was known of every commanded arm."""
    scope: str = ""
    """The arm that holds the endoscope, where its pose follows from the joints; empty: unknown."""

    def difference(self, other: Layout) -> str | None:
        """The property that excludes ``other`` from an export with this layout, or None."""
        for field in dataclasses.fields(self):
            mine, theirs = getattr(self, field.name), getattr(other, field.name)
            if mine != theirs:
                name = _FIELD_NAMES.get(field.name, field.name)
                return f"{name}: {_words(theirs)}, but this export has {_words(mine)}"
        return None


_FIELD_NAMES = {
    "joints": "joints per arm",
    "commanded": "commanded arms",
    "sizes": "picture sizes",
    "labelled": "judged by a task",
    "task_numbers": "numbers of the task's state",
    "truth": "ground truth",
    "forces": "forces at tip and trocar",
    "scope": "arm with the pose of the camera",
}


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
    """What a reader should be told: no hashes, declared edits, verdicts that disagree."""


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


def look(folder: Path, options: ExportOptions) -> Candidate:
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
    run, judged = _mapping(manifest.get("run")), verdict(manifest)
    remarks = integrity.remarks(recorded)
    if options.cameras is None:
        remarks += [
            f"left out: {name}, values of {kind}" for name, kind in _measured(recorded).items()
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
            "software": _mapping(manifest.get("versions")).get("software"),
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


def layout_of(recorded: Episode, options: ExportOptions) -> Layout:
    """The layout of a recording; an EpisodeError if it lacks what every export needs."""
    manifest, folder = recorded.manifest, recorded.folder
    tables = manifest["tables"]
    arms = tuple(recorded.arms)
    if not arms:
        raise EpisodeError(f"{folder}: no arm was recorded (key 'arms' of the manifest is empty)")
    commanded = tuple(arm for arm in arms if _mapping(tables.get(f"command_{arm}")).get("rows"))
    if not commanded:
        raise EpisodeError(f"{folder}: no arm was commanded: there is no action to export")
    described = _mapping(_mapping(manifest.get("cell")).get("arms"))
    parts = {arm: _mapping(described.get(arm)) for arm in arms}
    robot_of_run = _mapping(manifest.get("run")).get("robot")
    task = _mapping(tables.get("task_state"))
    labelled = bool(task.get("rows"))
    keep_task = labelled and TASK_STATE_KEY not in options.drop
    truths = [_mapping(tables.get(f"ground_truth_{arm}")).get("rows") for arm in arms]
    felt = [any(_rows(tables, f"{place}_force_{arm}") for place in PLACES) for arm in commanded]
    cameras, sizes = _cameras(recorded, options)
    return Layout(
        arms=arms,
        robots=tuple(
            str(_mapping(parts[arm].get("robot")).get("name") or robot_of_run) for arm in arms
        ),
        joints=tuple(_joint_count(recorded, arm) for arm in arms),
        instruments=tuple(
            str(_mapping(parts[arm].get("instrument")).get("name") or "unknown") for arm in arms
        ),
        commanded=commanded,
        cameras=cameras,
        sizes=sizes,
        labelled=labelled,
        task_numbers=tuple(
            name
            for name in task.get("columns", [])
            if keep_task and name.startswith(table_columns.TASK_PREFIX)
        ),
        truth=all(truths) and schema.GROUND_TRUTH not in options.drop,
        forces=all(felt) and FORCE_KEY not in options.drop,
        scope=_scope(recorded, options),
    )


def _rows(tables: Mapping[str, Any], name: str) -> int:
    """Rows of a table; 0 if there is none."""
    return int(_mapping(tables.get(name)).get("rows") or 0)


def _scope(recorded: Episode, options: ExportOptions) -> str:
    """The recorded arm from whose joints the camera's pose follows; empty: there is none."""
    held = calibration_record.endoscope_of(recorded.folder, recorded.manifest)
    if held is None or held.arm not in recorded.arms or schema.CAMERA_POSE in options.drop:
        return ""
    joints = _joint_count(recorded, held.arm)
    if joints != held.chain.dof:
        raise EpisodeError(
            f"{recorded.folder}: {held.arm} has {joints} joints in its cycles, and"
            f" {held.chain.dof} in 'cell.endoscope' of the manifest"
        )
    return held.arm


def _joint_count(recorded: Episode, arm: str) -> int:
    """Number of joints in the cycles of an arm."""
    entry = recorded.manifest["tables"].get(f"cycle_{arm}")
    if not entry or not entry.get("rows"):
        raise EpisodeError(
            f"{recorded.folder}: no control cycle of {arm} was recorded; nothing to export"
        )
    if not entry.get("columns"):
        raise EpisodeError(f"{recorded.folder}: the manifest lacks 'tables.cycle_{arm}.columns'")
    return table_columns.joint_count(entry["columns"])


def _cameras(
    recorded: Episode, options: ExportOptions
) -> tuple[tuple[str, ...], tuple[tuple[int, int], ...]]:
    """Names of the cameras to export, and width and height of their pictures [px]."""
    videos, folder = recorded.manifest["videos"], recorded.folder
    measured = _measured(recorded)
    own = tuple(camera for camera in recorded.cameras if camera not in measured)
    cameras = own if options.cameras is None else options.cameras
    sizes = []
    for camera in cameras:
        entry = videos.get(camera)
        if camera in measured:
            raise EpisodeError(
                f"{folder}: {camera} holds values ({measured[camera]}), and data sets hold pictures"
                f" of colours; allowed: {', '.join(own) or 'none'}"
            )
        if not entry:
            raise EpisodeError(
                f"{folder}: no camera {camera!r}; there are {', '.join(own) or 'none'}"
            )
        further = any(_mapping(video).get("part_of") == camera for video in videos.values())
        if further and segment_of(recorded) is None:
            raise EpisodeError(
                f"{folder}: {camera} has more than one video (its size changed, or its encoder was"
                " killed); --cameras names those to take"
            )
        if not entry.get("frames"):
            raise EpisodeError(f"{folder}: {camera} holds no frame")
        sizes.append(pictures.size_of(folder / f"{camera}.mp4"))
    return tuple(cameras), tuple(sizes)


def _measured(recorded: Episode) -> dict[str, str]:
    """Encodings of the cameras that hold measured values, such as depth."""
    found, streams = {}, _mapping(recorded.manifest.get("camera_streams"))
    for camera in recorded.cameras:
        encoding = str(_mapping(streams.get(camera)).get("encoding"))
        if encoding in ENCODINGS and ENCODINGS[encoding].codec != "h264":
            found[camera] = encoding
    return found


def kind_of(manifest: Mapping[str, Any]) -> str:
    """Success, recovery or failure: by the verdict, then by the tag ``recovery``."""
    if verdict(manifest).success is False:
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


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _words(value: Any) -> str:
    if isinstance(value, tuple):
        shown = [f"{v[0]}x{v[1]}" if isinstance(v, tuple) else str(v) for v in value]
        return ", ".join(shown) or "none"
    return "yes" if value is True else "no" if value is False else str(value)
