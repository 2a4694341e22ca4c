"""Reads LeRobot data sets 2.1 and 3.0, and imports their episodes.

Data sets of ``./surg episode export`` name their columns (``PSM1/tip_x``) and need nothing. For
others a map says which column is what (docs/reference/imports.md).
"""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq

from surg_core.contract import ACTION_KEY, ARM_ACTION, ARM_STATE, SECOND_NS, STATE_KEY
from surg_recording.datasets import schema
from surg_recording.datasets.frames.resample import offsets_ns
from surg_recording.imports.arm_series import ArmSeries, Picture, header, write
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]

_MEASURED = ARM_STATE[: len(ARM_ACTION)]  # the measured ones come first
START_NS = SECOND_NS
"""Stamp of the first frame where the data set states none [ns]."""


@dataclasses.dataclass(frozen=True)
class ArmColumns:
    """Where the numbers of an arm are."""

    name: str
    measured: tuple[str, tuple[int, ...]]
    """Feature, and the columns of tip x, y, z, roll and jaw; -1: there is none."""
    goal: tuple[str, tuple[int, ...]] | None
    joints: tuple[str, tuple[int, ...]] | None


class LeRobotData:
    """A data set on the disk."""

    def __init__(self, root: Path) -> None:
        """Read its description; an EpisodeError if it is none."""
        self.root = root
        try:
            self.info: dict[str, Any] = json.loads((root / "meta" / "info.json").read_text("utf-8"))
            self.fps, self.count = int(self.info["fps"]), int(self.info["total_episodes"])
            self.features: dict[str, dict[str, Any]] = self.info["features"]
        except (OSError, ValueError, KeyError, TypeError) as problem:
            raise EpisodeError(f"{root}: no LeRobot data set (meta/info.json: {problem})") from None
        self.videos = [name for name, f in self.features.items() if f.get("dtype") == "video"]
        self._rows = _episode_rows(root)

    def table(self, episode: int) -> Any:
        """The rows of an episode, in order."""
        path = self.root / self.info["data_path"].format(**self._place(episode, "data"))
        try:
            table = pq.read_table(path, filters=[("episode_index", "=", episode)])
        except (OSError, ValueError) as problem:
            raise EpisodeError(f"{path}: cannot be read ({problem})") from None
        if not table.num_rows:
            raise EpisodeError(f"{path}: holds no row of episode {episode}")
        return table.sort_by("frame_index")

    def pictures(self, episode: int, video: str, count: int) -> Iterator[npt.NDArray[np.uint8]]:
        """The ``count`` pictures (height, width, 3) of an episode."""
        place = self._place(episode, f"videos/{video}")
        path = self.root / self.info["video_path"].format(video_key=video, **place)
        row = self._rows.get(episode, {})
        first = round(float(row.get(f"videos/{video}/from_timestamp", 0.0)) * self.fps)
        try:
            with av.open(str(path)) as container:
                frames = itertools.islice(container.decode(video=0), first, first + count)
                for frame in frames:
                    yield frame.to_ndarray(format="rgb24")
        except (av.error.FFmpegError, IndexError) as problem:
            raise EpisodeError(f"{path}: cannot be decoded ({problem})") from None

    def task(self, table: Any) -> str:
        """The instruction of an episode's first frame."""
        if schema.INSTRUCTION in table.column_names:
            return str(table.column(schema.INSTRUCTION)[0].as_py())
        lines = self.root / "meta" / "tasks.jsonl"
        if not lines.is_file():
            return "not stated"
        tasks = [json.loads(line) for line in lines.read_text("utf-8").splitlines()]
        index = table.column("task_index")[0].as_py()
        return next((t["task"] for t in tasks if t["task_index"] == index), "not stated")

    def _place(self, episode: int, prefix: str) -> dict[str, int]:
        row = self._rows.get(episode, {})
        found = {
            key: int(row[f"{prefix}/{key}"])
            for key in ("chunk_index", "file_index")
            if f"{prefix}/{key}" in row
        }
        chunk = episode // int(self.info.get("chunks_size", 1000))
        return {"episode_index": episode, "episode_chunk": chunk, **found}


def _episode_rows(root: Path) -> dict[int, dict[str, Any]]:
    """Rows of ``meta/episodes`` of a data set 3.0; none for 2.1."""
    files = sorted((root / "meta" / "episodes").rglob("*.parquet"))
    rows = [row for file in files for row in pq.read_table(file).to_pylist()]
    return {int(row["episode_index"]): row for row in rows}


def columns_of(data: LeRobotData, stated: Mapping[str, Any] | None) -> list[ArmColumns]:
    """The arms of a data set, from its names or from a map's ``arms``.

    Raises:
        EpisodeError: No arm is found, or the map names what the data set lacks.
    """
    if stated is not None:
        return [_mapped(data, str(name), entry) for name, entry in stated.items()]
    names = _names(data, STATE_KEY)
    arms = dict.fromkeys(n.partition("/")[0] for n in names if n.endswith("/tip_x"))
    if not arms:
        raise EpisodeError(
            f"{data.root}: {STATE_KEY} has no columns such as PSM1/tip_x, but"
            f" {', '.join(names) or 'no names'}; --map FILE says which column is what"
        )
    found = []
    for arm in arms:
        measured = tuple(names.index(f"{arm}/{name}") for name in _MEASURED)
        commanded = _names(data, ACTION_KEY)
        goal = [f"{arm}/{name}" for name in ARM_ACTION]
        joints = _names(data, "observation.joint_positions")
        mine = tuple(i for i, name in enumerate(joints) if name.startswith(f"{arm}/"))
        at = tuple(map(commanded.index, goal)) if set(goal) <= set(commanded) else None
        found.append(
            ArmColumns(
                arm,
                (STATE_KEY, measured),
                (ACTION_KEY, at) if at else None,
                ("observation.joint_positions", mine) if mine else None,
            )
        )
    return found


def _mapped(data: LeRobotData, arm: str, entry: Any) -> ArmColumns:
    if not isinstance(entry, Mapping) or not isinstance(entry.get("measured"), Mapping):
        raise EpisodeError(f"--map, arms.{arm}: 'measured' with x, y and z is needed")

    def place(key: str, wanted: Sequence[str]) -> tuple[str, tuple[int, ...]] | None:
        stated = entry.get(key)
        if stated is None:
            return None
        feature = str(stated.get("feature", STATE_KEY if key == "measured" else ACTION_KEY))
        return feature, tuple(
            _index(data, feature, stated.get(name), f"arms.{arm}.{key}.{name}") for name in wanted
        )

    measured = place("measured", ARM_ACTION)
    assert measured is not None
    if min(measured[1][:3]) < 0:
        raise EpisodeError(f"--map, arms.{arm}.measured: x, y and z are needed")
    return ArmColumns(arm, measured, place("goal", ARM_ACTION), None)


def _index(data: LeRobotData, feature: str, stated: Any, where: str) -> int:
    """Column number of a name or number; -1 for none."""
    names = _names(data, feature)
    if stated is None:
        return -1
    if isinstance(stated, int) and 0 <= stated < _width(data, feature):
        return stated
    if stated in names:
        return names.index(stated)
    raise EpisodeError(
        f"--map, {where}: {stated!r} is not in {feature}; there are {', '.join(names) or 'none'}"
    )


def _width(data: LeRobotData, feature: str) -> int:
    if feature not in data.features:
        known = ", ".join(data.features)
        raise EpisodeError(f"{data.root}: no feature {feature}; there are {known}")
    return int(data.features[feature]["shape"][0])


def _names(data: LeRobotData, feature: str) -> list[str]:
    """Names of a feature's columns: a list, or (as some write them) a map with one list."""
    names = data.features.get(feature, {}).get("names") or []
    if isinstance(names, Mapping):
        (names,) = names.values()
    return [str(name) for name in names]


def import_episode(
    data: LeRobotData, episode: int, folder: Path, stated: Mapping[str, Any] | None = None
) -> Path:
    """Write one episode of a data set as an episode folder; an EpisodeError says why not."""
    stated = stated or {}
    table = data.table(episode)
    times = START_NS + offsets_ns(np.arange(table.num_rows), data.fps)
    if "timing.grid_ns" in table.column_names:
        times = _numbers(table, "timing.grid_ns")[:, 0].astype(np.int64)
    arms = [_series(table, each, times, stated) for each in columns_of(data, stated.get("arms"))]
    cameras = {_camera(name): name for name in data.videos}
    instruction = data.task(table)
    success = None
    if "next.success" in table.column_names:
        success = bool(_numbers(table, "next.success")[-1, 0])
    facts = {key: stated.get(key) for key in ("task", "operator") if stated.get(key)}
    run: dict[str, Any] = {
        "instruction": instruction,
        "setting": stated.get("setting"),
        "robot": arms[0].robot,
    }
    source = {"format": "lerobot", "from": str(data.root), "episode": episode}
    manifest: dict[str, Any] = {
        **facts,
        "run": {**run, **facts},
        "imported": source,
        "clock": "data set",
    }
    manifest.setdefault("task", instruction)
    return write(
        folder, arms, list(cameras), _pictures(data, episode, cameras, times), manifest, success
    )


def _camera(video: str) -> str:
    return video.removeprefix("observation.images.").replace(".", "_")


def _pictures(
    data: LeRobotData, episode: int, cameras: Mapping[str, str], times: npt.NDArray[np.int64]
) -> Iterator[Picture]:
    for camera, video in cameras.items():
        shown = data.pictures(episode, video, len(times))
        for stamp, image in zip(map(int, times), shown, strict=True):
            height, width = image.shape[:2]
            message = SimpleNamespace(
                header=header(stamp), width=width, height=height, step=3 * width, encoding="rgb8"
            )
            message.data = image.tobytes()
            yield Picture(camera, message, stamp)


def _series(
    table: Any, arm: ArmColumns, times: npt.NDArray[np.int64], stated: Mapping[str, Any]
) -> ArmSeries:
    measured = _picked(table, *arm.measured)
    goal = measured if arm.goal is None else _held(_picked(table, *arm.goal), measured)
    q = np.zeros((len(times), 0)) if arm.joints is None else _picked(table, *arm.joints)
    about = (stated.get("arms") or {}).get(arm.name) or {}
    return ArmSeries(
        name=arm.name,
        stamps=times,
        p_BTip=measured[:, :3],
        roll=measured[:, 3],
        jaw=measured[:, 4],
        q=q,
        qd=np.gradient(q, times * 1e-9, axis=0) if q.size else q,
        p_BGoal=goal[:, :3],
        roll_goal=goal[:, 3],
        jaw_goal=goal[:, 4],
        p_BRcm=np.array(about.get("rcm", [0.0, 0.0, 0.0]), dtype=np.float64),
        rpy_BR=np.array(about.get("rcm_rpy", [0.0, 0.0, 0.0]), dtype=np.float64),
        robot=str(about.get("robot", "unknown")),
        instrument=str(about.get("instrument", "unknown")),
    )


def _held(goal: Array, measured: Array) -> Array:
    """Commands in force at each frame: the action of frame k is that of frame k + 1."""
    held = np.vstack([goal[:1], goal[:-1]])
    return np.where(np.isnan(held), measured, held)


def _picked(table: Any, feature: str, columns: Sequence[int]) -> Array:
    """(N, columns) numbers; NaN for column -1 except roll and jaw, which are then 0."""
    values = _numbers(table, feature)
    picked = [values[:, i] if i >= 0 else np.zeros(len(values)) for i in columns]
    return np.column_stack(picked)


def _numbers(table: Any, name: str) -> Array:
    """A column as (N, D) float64."""
    if name not in table.column_names:
        raise EpisodeError(f"the data set has no column {name}")
    values = np.array(table.column(name).to_pylist())
    return values.reshape(len(values), -1)
