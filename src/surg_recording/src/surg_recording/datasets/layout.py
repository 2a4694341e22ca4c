"""What all recordings of one export share: arms, robots, cameras, and what else was recorded."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from surg_core.contract import FORCE_KEY, TASK_STATE_KEY
from surg_core.force.observed_force import PLACES
from surg_recording.calibration import calibration_record
from surg_recording.datasets import pictures, schema
from surg_recording.datasets.options import ExportOptions
from surg_recording.episode import table_columns
from surg_recording.episode.checked.checked_reading import segment_of
from surg_recording.episode.checked.long_table import WRIST
from surg_recording.episode.episode_reader import Episode
from surg_recording.recording_errors import EpisodeError
from surg_recording.video.video_encoder import ENCODINGS


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


def layout_of(recorded: Episode, options: ExportOptions) -> Layout:
    """The layout of a recording; an EpisodeError if it lacks what every export needs."""
    manifest, folder = recorded.manifest, recorded.folder
    tables = manifest["tables"]
    arms = tuple(recorded.arms)
    if not arms:
        raise EpisodeError(f"{folder}: no arm was recorded (key 'arms' of the manifest is empty)")
    commanded = tuple(arm for arm in arms if mapping(tables.get(f"command_{arm}")).get("rows"))
    if not commanded:
        raise EpisodeError(f"{folder}: no arm was commanded: there is no action to export")
    described = mapping(mapping(manifest.get("cell")).get("arms"))
    parts = {arm: mapping(described.get(arm)) for arm in arms}
    for arm in commanded:
        bent = mapping(parts[arm].get("instrument")).get("wrist")
        if bent and WRIST[0] not in mapping(tables.get(f"cycle_{arm}")).get("columns", ()):
            raise EpisodeError(
                f"{folder}: {arm}: the recording does not hold the turn of its instrument's wrist, "
                "so its orientations would be wrong; record it again"
            )
    robot_of_run = mapping(manifest.get("run")).get("robot")
    task = mapping(tables.get("task_state"))
    labelled = bool(task.get("rows"))
    keep_task = labelled and TASK_STATE_KEY not in options.drop
    truths = [mapping(tables.get(f"ground_truth_{arm}")).get("rows") for arm in arms]
    felt = [any(_rows(tables, f"{place}_force_{arm}") for place in PLACES) for arm in commanded]
    cameras, sizes = _cameras(recorded, options)
    return Layout(
        arms=arms,
        robots=tuple(
            str(mapping(parts[arm].get("robot")).get("name") or robot_of_run) for arm in arms
        ),
        joints=tuple(_joint_count(recorded, arm) for arm in arms),
        instruments=tuple(
            str(mapping(parts[arm].get("instrument")).get("name") or "unknown") for arm in arms
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
    return int(mapping(tables.get(name)).get("rows") or 0)


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
    measured = measured_cameras(recorded)
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
        further = any(mapping(video).get("part_of") == camera for video in videos.values())
        if further and segment_of(recorded) is None:
            raise EpisodeError(
                f"{folder}: {camera} has more than one video (its size changed, or its encoder was"
                " killed); --cameras names those to take"
            )
        if not entry.get("frames"):
            raise EpisodeError(f"{folder}: {camera} holds no frame")
        sizes.append(pictures.size_of(folder / f"{camera}.mp4"))
    return tuple(cameras), tuple(sizes)


def measured_cameras(recorded: Episode) -> dict[str, str]:
    """Encodings of the cameras that hold measured values, such as depth."""
    found, streams = {}, mapping(recorded.manifest.get("camera_streams"))
    for camera in recorded.cameras:
        encoding = str(mapping(streams.get(camera)).get("encoding"))
        if encoding in ENCODINGS and ENCODINGS[encoding].codec != "h264":
            found[camera] = encoding
    return found


def mapping(value: Any) -> Mapping[str, Any]:
    """A mapping of a manifest; empty if the value is none."""
    return value if isinstance(value, Mapping) else {}


def _words(value: Any) -> str:
    if isinstance(value, tuple):
        shown = [f"{v[0]}x{v[1]}" if isinstance(v, tuple) else str(v) for v in value]
        return ", ".join(shown) or "none"
    return "yes" if value is True else "no" if value is False else str(value)
