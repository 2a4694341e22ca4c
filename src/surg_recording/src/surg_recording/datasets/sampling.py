"""Resamples a recording to the grid: every feature of every frame, with true stamps and ages.

The grid begins with the first picture at which all series have begun, the arms are homed and an
action is known. It ends when the first series ends. An observation is the state at a grid time; an
action is the command in force at the next one: set-point and jaw at that time, with the names of
surg_sim.envs.surg_env.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator
from typing import Any

import av
import numpy as np
import numpy.typing as npt

from surg_core.action_space import ActionSpace
from surg_core.contract import (
    ACTION_KEY,
    ARM_FORCE,
    ARM_FORCE_UNITS,
    ARM_STATE,
    ARM_STATE_UNITS,
    FORCE_KEY,
    FORCE_TIMEOUT_NS,
    SECOND_NS,
    STATE_KEY,
    TASK_STATE_KEY,
    image_key,
)
from surg_core.force.observed_force import PLACES
from surg_core.transforms import rotate_back
from surg_recording.calibration import calibration_record
from surg_recording.clock.clock_segments import Segment
from surg_recording.datasets import pictures, schema, stream_copy
from surg_recording.datasets.arm_motion import ArmCycles, ArmMotion
from surg_recording.datasets.frame_columns import Columns
from surg_recording.datasets.inspection import Candidate
from surg_recording.datasets.options import COPY, ExportOptions
from surg_recording.datasets.resample import (
    Grid,
    Stamps,
    around,
    linear,
    offsets_ns,
    previous,
    slerp,
)
from surg_recording.datasets.schema import Feature
from surg_recording.episode import episode_reader, labels, long_table, table_columns
from surg_recording.episode.checked_reading import checked_table, checked_video, measured_force
from surg_recording.episode.episode_reader import Table
from surg_recording.episode.long_table import LongTable
from surg_recording.episode.verdicts import PERSON, Verdict
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]

_LINEAR = "linear interpolation"
_HOLD = "zero-order hold"
_BEFORE = "newest sample before the frame"
_NEXT = "zero-order hold at the next grid time"


@dataclasses.dataclass(frozen=True)
class Pictures:
    """The recorded frame of each grid time."""

    video: episode_reader.Video
    index: Stamps
    """(frames,) indices into the recorded video's frames."""


@dataclasses.dataclass(frozen=True)
class Sampled:
    """A recording on its grid."""

    candidate: Candidate
    grid: Grid
    features: tuple[Feature, ...]
    columns: dict[str, npt.NDArray[Any]]
    """By feature name: (frames, D), or (frames,) where D is 1; text as an object array."""
    pictures: dict[str, Pictures]
    notes: dict[str, Any]
    """Facts for the report: repeated, skipped and oldest pictures."""

    def pieces(self, longest_s: float | None) -> list[Sampled]:
        """The recording in pieces of nearly equal length, none longer than ``longest_s`` [s]."""
        fps, frames = self.grid.fps, self.grid.frames
        if longest_s is None or frames <= longest_s * fps:
            return [self]
        count = math.ceil(frames / (math.floor(longest_s) * fps))
        # Pieces begin at whole seconds of the grid: there its times need no rounding.
        ends = [math.ceil(frames / fps * n / count) * fps for n in range(count)] + [frames]
        return [self._piece(first, end) for first, end in itertools.pairwise(ends)]

    def _piece(self, first: int, end: int) -> Sampled:
        """The frames from ``first`` to before ``end``."""
        start = int(self.grid.times_ns[first])
        return dataclasses.replace(
            self,
            grid=dataclasses.replace(self.grid, start_ns=start, frames=end - first),
            columns={name: values[first:end] for name, values in self.columns.items()},
            pictures={
                name: dataclasses.replace(shown, index=shown.index[first:end])
                for name, shown in self.pictures.items()
            },
        )

    def frames(self, feature: str) -> Iterator[av.VideoFrame]:
        """The pictures of a video feature in the grid's order."""
        shown = self.pictures[feature]
        return pictures.recorded_frames(shown.video.path, [int(i) for i in shown.index])


def sample(candidate: Candidate, options: ExportOptions) -> Sampled:
    """Read and resample a recording; an EpisodeError names what is missing, broken or too old."""
    recorded = episode_reader.read(candidate.folder)
    layout, segment = candidate.layout, candidate.segment
    cycles = {
        name: ArmCycles.read(recorded, name, segment, name in layout.commanded)
        for name in layout.arms
    }
    commanded = [cycles[name] for name in layout.commanded]
    videos = {camera: checked_video(recorded, camera, segment) for camera in layout.cameras}
    for (camera, video), size in zip(videos.items(), layout.sizes, strict=True):
        if segment is not None and pictures.size_of(video.path) != size:
            raise EpisodeError(
                f"{video.path}: another size than {camera} has before; {segment.words}"
            )
    task = checked_table(recorded, "task_state", segment) if layout.labelled else None
    true = layout.arms if layout.truth else ()
    truth = [long_table.truth(recorded, arm, segment) for arm in true]
    long = [*(arm.table for arm in cycles.values()), *truth]
    others = [*(table.index for table in long), *([task] if task else [])]
    trim = labels.trim(recorded.manifest)
    grid = _grid(candidate, commanded, videos, others, options, trim)
    arms = {name: arm.at(grid) for name, arm in cycles.items()}

    made = Columns(grid, options)
    if segment is not None:
        made.notes["segment"] = segment.words
    if candidate.remarks:
        made.notes["remarks"] = list(candidate.remarks)
    _observe(made, [arms[name] for name in layout.commanded], list(arms.values()))
    if layout.forces:
        _feel(made, recorded, segment, [arms[name] for name in layout.commanded])
    if layout.scope:
        _look(made, recorded, arms[layout.scope])
    _act(made, [arms[name] for name in layout.commanded])
    shown = _show(made, candidate, videos)
    if task is not None:
        at_the_end = segment is None or segment.until is None
        _label(made, task, candidate.verdict, at_the_end)
        if layout.task_numbers:
            _privileged_task(made, task, layout.task_numbers)
    if truth:
        _privileged_truth(made, layout.arms, truth)
    made.text(schema.INSTRUCTION, candidate.instruction, "what the operator was to do")
    made.text(schema.STAGE, _stage_texts(candidate, grid), "the same of the current stage", _HOLD)
    tools = "; ".join(f"{a}: {i}" for a, i in zip(layout.arms, layout.instruments, strict=True))
    made.text(schema.TOOL, tools, "instrument of each arm")
    text = "time of the frame on the recording's clock"
    made.number("timing.grid_ns", grid.times_ns, "int64", ("ns",), text=text)
    features = tuple(sorted(made.features, key=lambda feature: schema.rank(feature.name)))
    unknown = set(options.drop) - set(made.dropped) - schema.OPTIONAL
    if unknown:
        raise EpisodeError(
            f"--drop {', '.join(sorted(unknown))}: no such feature; there are"
            f" {', '.join(feature.name for feature in features)}"
        )
    made.check_columns()
    return Sampled(candidate, grid, features, made.columns, shown, made.notes)


# --- the grid ---------------------------------------------------------------------------------


def _grid(
    candidate: Candidate,
    arms: list[ArmCycles],
    videos: dict[str, episode_reader.Video],
    others: list[Table],
    options: ExportOptions,
    trim: tuple[int, int],
) -> Grid:
    """The grid within the labels' ``trim``: first and last stamp to use [ns]."""
    period = int(offsets_ns(np.array([1]), options.fps)[0])
    obeyed = [arm.stamps[arm.command > 0] for arm in arms]
    commands = [int(stamps[0]) for stamps in obeyed if len(stamps)]
    if not commands:
        raise EpisodeError(
            f"{candidate.folder}: no motion command was obeyed: there is no action to export"
        )
    tables = {table.name: table["stamp_ns"] for table in others}
    pictures_ns = [video.frames["stamp_ns"] for video in videos.values()]
    firsts = [*(arm.stamps[0] for arm in arms), *(s[0] for s in (*pictures_ns, *tables.values()))]
    begin = int(max(*firsts, min(commands) - period, trim[0]))
    # A command answers an observation one tick before it. A grid on the commands' stamps would
    # pair every observation with the answer to the next one.
    observed = tables.pop("task_state", None)
    lasts = [*(arm.stamps[-1] - period for arm in arms)]
    lasts += [s[-1] for s in (*pictures_ns, *tables.values())]
    end = int(min(*lasts, trim[1]))
    reference = pictures_ns[0] if pictures_ns else observed
    if videos and options.video == COPY:  # a copied video begins with a key frame
        video = next(iter(videos.values()))
        keys = video.frames["stamp_ns"][
            np.isin(video.frames["frame"], stream_copy.keys(video.path))
        ]
        reference = keys if (keys >= begin).any() else reference
    if reference is not None:
        later = reference[reference >= begin]
        begin = int(later[0]) if len(later) else end + 1
    frames = (end - begin) * options.fps // SECOND_NS + 1 if end >= begin else 0
    if frames < 2:
        raise EpisodeError(
            f"{candidate.folder}: {max(frames, 0)} frames at {options.fps} per second: pictures,"
            " motion and commands overlap too shortly to export"
        )
    return Grid(begin, options.fps, int(frames))


# --- features ---------------------------------------------------------------------------------


def _observe(made: Columns, commanded: list[ArmMotion], arms: list[ArmMotion]) -> None:
    """Measured values: joints of all arms, tips of those that are commanded and so homed."""
    grid, gap = made.grid, round(made.options.max_gap_s * SECOND_NS)
    states, poses = [], []
    for arm in commanded:
        both = np.column_stack([arm.state, arm.p_BTip])
        resampled, _ = linear(arm.stamps, both, grid.times_ns, arm.path, gap)
        quaternion, _ = slerp(arm.stamps, arm.q_BTool, grid.times_ns, arm.path, gap)
        states.append(resampled[:, : arm.state.shape[1]])
        poses.append(np.column_stack([resampled[:, arm.state.shape[1] :], quaternion]))
    names = [arm.name for arm in commanded]
    made.vector(
        STATE_KEY,
        np.hstack(states),
        _named(names, ARM_STATE),
        ARM_STATE_UNITS * len(names),
        "rcm frame of each arm",
        _LINEAR,
        "measured tip, roll and jaw; set-point of tip and roll",
    )
    made.vector(
        "observation.cartesian_state",
        np.hstack(poses),
        _named(names, schema.POSE),
        schema.POSE_UNITS * len(names),
        "base frame of each arm",
        "linear interpolation; slerp",
        "measured pose of the tool: tip and orientation (quaternion x, y, z, w)",
    )
    for kind, prefix, unit in (("positions", "q", "rad"), ("velocities", "qd", "rad/s")):
        values, flat = [], []
        for arm in arms:
            measured = arm.q if prefix == "q" else arm.qd
            resampled, before = linear(arm.stamps, measured, grid.times_ns, arm.path, gap)
            values.append(resampled)
            flat += [f"{arm.name}/{prefix}{i}" for i in range(resampled.shape[1])]
            if prefix == "q":
                text = f"cycle of {arm.name} before this frame"
                made.timing(arm.name, arm.stamps, before, grid.times_ns, text)
        made.vector(
            f"observation.joint_{kind}",
            np.hstack(values),
            tuple(flat),
            (unit,) * len(flat),
            "",
            _LINEAR,
            f"measured joint {kind}",
        )


def _feel(
    made: Columns, recorded: episode_reader.Episode, segment: Segment | None, arms: list[ArmMotion]
) -> None:
    """Forces at tip and trocar: the newest measured before each frame, if it is fresh."""
    times, parts = made.grid.times_ns, []
    for arm in arms:
        for place in PLACES:
            table = measured_force(recorded, place, arm.name, segment)
            values = np.zeros((len(times), 4))
            if table is not None:
                row = np.searchsorted(table["stamp_ns"], times, side="left") - 1
                known = (row >= 0) & (table["known"][row] == 1)
                known &= times - table["stamp_ns"][row] <= FORCE_TIMEOUT_NS
                force = table.vector("force")[row]
                turned = rotate_back(arm.q_BR_at(times), force)
                values = np.where(known[:, None], np.column_stack([turned, known]), 0.0)
            parts.append(values)
    names = [arm.name for arm in arms]
    made.vector(
        FORCE_KEY,
        np.hstack(parts),
        _named(names, ARM_FORCE),
        ARM_FORCE_UNITS * len(names),
        "rcm frame of each arm",
        _BEFORE,
        "force on the tip and of the shaft on the trocar; known: 1, or 0 and no force",
    )


def _look(made: Columns, recorded: episode_reader.Episode, arm: ArmMotion) -> None:
    """The pose of the left camera, from the joints of the arm that holds it."""
    held = calibration_record.endoscope_of(recorded.folder, recorded.manifest)
    assert held is not None
    gap = round(made.options.max_gap_s * SECOND_NS)
    q, _ = linear(arm.stamps, arm.q, made.grid.times_ns, arm.path, gap)
    made.vector(
        schema.CAMERA_POSE,
        calibration_record.camera_poses(held, q),
        schema.POSE,
        schema.POSE_UNITS,
        "world",
        _LINEAR,
        "pose X_WV of the left camera (x right, y down, z away), by joints and calibration",
    )


_ACTIONS = {
    "absolute": "where tip, roll and jaw shall be at the next frame; absolute",
    "relative": "change of the command for tip and roll from this frame to the next; jaw absolute",
    "velocity": "the same change per second: mean velocity of the command; jaw absolute",
    "joint": "where tip, roll and jaw shall be at the next frame, as joints of the instrument",
}
"""Description of the action, by action space."""


def _act(made: Columns, arms: list[ArmMotion]) -> None:
    """The commands in force at the next grid times, in the action space of the export."""
    grid, goals, before = made.grid, [], []
    for arm in arms:
        what = f"commands of {arm.name}"
        row = previous(arm.stamps, grid.next_ns, what)
        goals.append(arm.goal[row])
        before.append(arm.goal[previous(arm.stamps, grid.times_ns, what)])
        text = f"cycle that accepted the action of {arm.name}"
        made.timing(f"{arm.name}.action", arm.goal_since_ns, row, grid.next_ns, text)
    names, space = [arm.name for arm in arms], ActionSpace(made.options.action_space)
    made.vector(
        ACTION_KEY,
        space.encode(np.hstack(goals), np.hstack(before), 1.0 / grid.fps),
        space.columns(names),
        space.units(names),
        "rcm frame of each arm",
        _NEXT,
        f"{_ACTIONS[space.name]} (action space: {space.name})",
    )


def _show(
    made: Columns, candidate: Candidate, videos: dict[str, episode_reader.Video]
) -> dict[str, Pictures]:
    """The picture of each grid time."""
    shown: dict[str, Pictures] = {}
    limit = round(made.options.max_image_age_s * SECOND_NS)
    for camera, video in videos.items():
        stamps = video.frames["stamp_ns"]
        index = previous(stamps, made.grid.times_ns, f"{video.path}", limit)
        width, height = made.options.size or candidate.layout.sizes[list(videos).index(camera)]
        name = image_key(camera)
        feature = Feature(
            name=name,
            dtype="video",
            shape=(height, width, 3),
            names=("height", "width", "channels"),
            method="newest picture that is not later",
            text=f"camera {camera}, RGB",
            camera=camera,
        )
        made.add(feature, None)
        if name in made.dropped:
            continue
        made.timing(camera, stamps, index, made.grid.times_ns, f"stamp of the picture of {camera}")
        steps = np.diff(index)
        made.notes[f"repeated_{camera}"] = int(np.sum(steps == 0))
        made.notes[f"skipped_{camera}"] = int(np.sum(np.maximum(steps - 1, 0)))
        shown[name] = Pictures(video, video.frames["frame"][index])
    return shown


def _label(made: Columns, task: Table, verdict: Verdict, at_the_end: bool) -> None:
    """Reward and success of the frame that an action leads to; the last frame has the verdict.

    A person's verdict counts first: what somebody called a failure has no frame of success.
    """
    row = previous(task["stamp_ns"], made.grid.next_ns, "task_state.csv")
    row[-1] = len(task) - 1
    last = np.zeros(made.grid.frames, dtype=bool)
    last[-1] = True
    made.number("next.reward", task["reward"][row], "float32", ("1",), _NEXT, "reward of the task")
    made.number("next.done", last, "bool", ("1",), "", "the recording's last frame")
    success = task["success"][row] == 1
    if verdict.by == PERSON:
        success[:] = success & bool(verdict.success)
        success[-1] = bool(verdict.success) and at_the_end
    made.number("next.success", success, "bool", ("1",), _NEXT, "the task was solved by then")


def _privileged_task(made: Columns, task: Table, numbers: tuple[str, ...]) -> None:
    row = previous(task["stamp_ns"], made.grid.times_ns, "task_state.csv")
    names = tuple(name.removeprefix(table_columns.TASK_PREFIX) for name in numbers)
    made.vector(
        TASK_STATE_KEY,
        np.column_stack([task[name] for name in numbers])[row],
        names,
        ("SI",) * len(names),
        "as the task's page says (world)",
        _HOLD,
        "ground truth of the task: no robot can measure it",
        privileged=True,
    )
    text = "stamp of the task's state"
    made.timing("task_state", task["stamp_ns"], row, made.grid.times_ns, text)


def _privileged_truth(made: Columns, arms: tuple[str, ...], truth: list[LongTable]) -> None:
    parts, names = [], []
    columns = [f"{name}_{axis}" for name in ("tip", "force") for axis in "xyz"]
    for arm, long in zip(arms, truth, strict=True):
        table = long.at(around(long.index["stamp_ns"], made.grid.times_ns), columns)
        values = np.column_stack([table.vector("tip"), table.vector("force")])
        gap = round(made.options.max_gap_s * SECOND_NS)
        what = f"ground_truth_{arm}.csv"
        resampled, _ = linear(table["stamp_ns"], values, made.grid.times_ns, what, gap)
        parts.append(resampled)
        names += [f"{arm}/{name}_{axis}" for name in ("tip", "force") for axis in "xyz"]
    made.vector(
        schema.GROUND_TRUTH,
        np.hstack(parts),
        tuple(names),
        ("m", "m", "m", "N", "N", "N") * len(arms),
        "base frame of each arm",
        _LINEAR,
        "the simulator's tip, and the force of the shaft on the trocar's wall",
        privileged=True,
    )


def _stage_texts(candidate: Candidate, grid: Grid) -> npt.NDArray[Any]:
    """What was to be done in each frame, (frames,); outside of all stages the instruction."""
    words = np.full(grid.frames, candidate.instruction, dtype=object)
    for stage in candidate.stages:
        inside = grid.times_ns >= stage.begin_ns
        if stage.end_ns is not None:
            inside &= grid.times_ns < stage.end_ns
        words[inside] = stage.text
    return words


def _named(arms: list[str], names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{arm}/{name}" for arm in arms for name in names)
