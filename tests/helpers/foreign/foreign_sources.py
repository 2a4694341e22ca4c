"""Bags and LeRobot data sets as other programs write them, and with their usual faults."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import rosbag
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from surg_recording.nodes.ros_messages_node import ros_time

HZ, START_NS = 100, 1_700_000_000_000_000_000
PERIOD_NS = 1_000_000_000 // HZ
LATENCY_NS = 500_000
"""From a message's stamp to its reception by the bag."""
FRAME = (64, 48)
"""Width and height of a data set's pictures [px]."""


def tip(t: float) -> list[float]:
    """Of a dVRK PSM at a time [s], whose base is the trocar with z out of the patient [m]."""
    return [0.02 * math.sin(2 * t), 0.015 * math.sin(3 * t + 1), -0.11 - 0.01 * math.cos(t)]


@dataclasses.dataclass
class BagMessage:
    """One sample of an arm: everything about it can be wrong."""

    stamp_ns: int
    received_ns: int
    p: list[float]
    q: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


def samples(count: int) -> list[BagMessage]:
    """Faultless ones."""
    times = [START_NS + n * PERIOD_NS for n in range(count)]
    return [BagMessage(t, t + LATENCY_NS, tip(n / HZ)) for n, t in enumerate(times)]


def write_bag(
    path: Path,
    messages: Sequence[BagMessage],
    joints: bool = True,
    further: Callable[[rosbag.Bag], None] = lambda bag: None,
    stamped: bool = True,
    **options: Any,
) -> Path:
    """A bag of PSM1 in the order of reception; ``joints`` of the same stamps, options of rosbag."""
    with rosbag.Bag(str(path), "w", **options) as bag:
        for n, each in enumerate(messages):
            header = Header(stamp=ros_time(each.stamp_ns), frame_id="PSM1_base")
            received = ros_time(each.received_ns)
            pose: Any = Pose(Point(*each.p), Quaternion(*each.q))
            bag.write("/PSM1/measured_cp", PoseStamped(header, pose) if stamped else pose, received)
            if joints:
                state = JointState(header=header, position=[0.1, 0.2, 0.12, 0.01 * n])
                bag.write("/PSM1/measured_js", state, received)
        further(bag)
    return path


def twin(bag: Path, folder: Path, storage: str, *words: str) -> Path:
    """The same bag in ROS 2, by the library's own program."""
    program = Path(sys.executable).with_name("rosbags-convert")
    stored = ["--dst-storage", storage, *words]
    argv = [program, "--src", bag, "--dst", folder / bag.stem, *stored]
    subprocess.run(argv, check=True, capture_output=True)
    return folder / bag.stem


# --- LeRobot --------------------------------------------------------------------------------------


@dataclasses.dataclass
class Rows:
    """One episode of a data set: its columns, each of which can be wrong."""

    count: int
    fps: float
    columns: dict[str, list[Any]] = dataclasses.field(init=False)
    task: str = "pick the needle"
    video_frames: list[int] = dataclasses.field(init=False)
    """Number that each picture of the video shows; a row shows that of its frame_index."""

    def __post_init__(self) -> None:
        index = range(self.count)
        state = [[*tip(k / self.fps), 0.1, 0.2] for k in index]
        self.columns = {
            "observation.state": state,
            "action": state,
            "timestamp": [k / self.fps for k in index],
            "frame_index": list(index),
            "task_index": [0] * self.count,
        }
        self.video_frames = list(index)


NAMES: Any = ["x", "y", "z", "roll", "jaw"]
MAP: Mapping[str, Any] = {
    "arms": {
        "PSM1": {
            "measured": {name: i for i, name in enumerate(NAMES)},
            "goal": {name: i for i, name in enumerate(NAMES)},
        }
    }
}


def number_picture(number: int) -> np.ndarray[Any, Any]:
    """A picture (height, width, 3) whose grey says a number below 47, also after a codec."""
    return np.full((FRAME[1], FRAME[0], 3), (20 + 5 * number) % 256, np.uint8)


def shown_number(image: np.ndarray[Any, Any]) -> int:
    """The number that ``number_picture`` drew."""
    return round((float(image.mean()) - 18.5) / 5)  # codecs darken by 1 to 2


def write_set(
    root: Path,
    episodes: Sequence[Rows],
    version: str = "v2.1",
    names: Any = NAMES,
    tasks: Sequence[str] = ("pick the needle",),
    camera: str | None = "video",
    **info: Any,
) -> Path:
    """A data set of version 2.1, or 3.0 with all episodes in one file."""
    fps, whole = episodes[0].fps, version == "v3.0"
    features: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [5], "names": names}
        for name in ("observation.state", "action")
    }
    if camera:
        shape = [FRAME[1], FRAME[0], 3]
        features["observation.images.cam"] = {"dtype": camera, "shape": shape, "names": None}
    data, video = "data/chunk-000", "videos/observation.images.cam"
    stated = {
        "codebase_version": version,
        "fps": fps,
        "total_episodes": len(episodes),
        "features": features,
        "data_path": f"{data}/{{}}.parquet".format(
            "file-{file_index:03d}" if whole else "episode_{episode_index:06d}"
        ),
        "video_path": "{}/{{video_key}}{}.mp4".format(
            "videos", "/file-{file_index:03d}" if whole else "/episode_{episode_index:06d}"
        ),
        **info,
    }
    for folder in (data, video, "meta/episodes/chunk-000"):
        (root / folder).mkdir(parents=True)
    (root / "meta/info.json").write_text(json.dumps(stated))
    tables, rows, pictures = [], [], 0
    for number, episode in enumerate(episodes):
        columns = {**episode.columns, "episode_index": [number] * episode.count}
        if camera == "image":
            columns["observation.images.cam"] = [_png(k) for k in columns["frame_index"]]
        tables.append(pa.table(columns))
        place = {"chunk_index": 0, "file_index": 0}
        rows.append(
            {
                "episode_index": number,
                "tasks": [episode.task],
                "length": episode.count,
                **{f"{of}/{key}": n for of in ("data", video) for key, n in place.items()},
                f"{video}/from_timestamp": pictures / fps if whole else 0.0,
            }
        )
        pictures += len(episode.video_frames)
    _write_tables(root, data, tables, rows, tasks, whole)
    if camera == "video":
        shown = [episode.video_frames for episode in episodes]
        files = {"file-000": list(itertools.chain(*shown))} if whole else _numbered(shown)
        for name, numbers in files.items():
            write_video(root / video / f"{name}.mp4", map(number_picture, numbers), fps)
    return root


def _numbered(each: Sequence[Any]) -> dict[str, Any]:
    return {f"episode_{number:06d}": content for number, content in enumerate(each)}


def _write_tables(
    root: Path, data: str, tables: Any, rows: Any, tasks: Sequence[str], whole: bool
) -> None:
    files = {"file-000": pa.concat_tables(tables)} if whole else _numbered(tables)
    for name, table in files.items():
        pq.write_table(table, root / data / f"{name}.parquet")
    indexed = [{"task_index": i, "task": text} for i, text in enumerate(tasks)]
    if whole:
        pq.write_table(pa.Table.from_pylist(rows), root / "meta/episodes/chunk-000/file.parquet")
        named = {"task_index": list(range(len(tasks))), "__index_level_0__": list(tasks)}
        pq.write_table(pa.table(named), root / "meta/tasks.parquet")
    else:
        for name, lines in (("episodes", rows), ("tasks", indexed)):
            text = "".join(json.dumps(line) + "\n" for line in lines)
            (root / f"meta/{name}.jsonl").write_text(text)


def _png(number: int) -> dict[str, Any]:
    import cv2

    return {"bytes": cv2.imencode(".png", number_picture(number))[1].tobytes(), "path": None}


def write_video(
    path: Path, images: Any, fps: float, filters: str = "null", tags: Sequence[str] = ()
) -> Path:
    """A video of RGB pictures by FFmpeg's own program, with its colour tags."""
    pictures = [np.asarray(image, np.uint8) for image in images]
    height, width = pictures[0].shape[:2]
    size = ["-s", f"{width}x{height}", "-r", str(fps)]
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", *size, "-i", "-", "-vf", filters]
    kept = ["-c:v", "libx264", "-crf", "4", "-pix_fmt", "yuv420p", *tags, str(path)]
    data = b"".join(picture.tobytes() for picture in pictures)
    subprocess.run(["ffmpeg", "-y", "-v", "error", *given, *kept], input=data, check=True)
    return path
