"""A LeRobot dataset (v2.1) with the left endoscope's pictures, for the trainers that look."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from surg_learn.bgr.image_policy import PICTURE
from surg_learn.cloning.arm_columns import ACTION, STATE, TASK, Array
from surg_learn.cloning.training.lerobot_dataset import (
    Dataset,
    Progress,
    facts,
    names_of,
    recordings,
)

CAMERA = "observation.camera_pose"
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass
class Episode:
    """One recording of T steps."""

    state: Array
    task: Array
    action: Array
    camera: Array
    """(T, 4, 4) pose of the left camera in the world."""
    views: Array
    """(T, SIDE, SIDE, 3), uint8, of `small`."""


def read(folder: Path, progress: Progress = lambda part, note: None) -> Dataset[Episode]:
    """Read the tables and the videos of a dataset.

    Raises:
        ValueError: The folder is no dataset, or a required feature is missing.
    """
    needed = (STATE, TASK, ACTION, CAMERA)
    info = facts(folder, (*needed, PICTURE))
    shape, K = info["features"][PICTURE]["shape"], intrinsics(folder)
    if shape[0] != K[3]:
        raise ValueError(
            f"{folder}: {PICTURE} has the shape {list(shape)} (meta/info.json), but the camera's "
            f"model is for a height of {K[3]:g} pixels (meta/calibration/index.json): export the "
            "recordings again, which scales both alike"
        )
    episodes: dict[str, list[Episode]] = {}
    names = names_of(info, needed)

    def show(part: float, note: str) -> None:
        progress(0.1 * part, f"pictures of {note}")

    for split, found in recordings(folder, info, needed, (PICTURE,), show):
        found[CAMERA] = matrices(found[CAMERA], names[CAMERA])
        episodes.setdefault(split, []).append(Episode(*found.values()))
    about = {"fps": info["fps"], "robot": info["robot_type"], "picture": shape, "K": K}
    return Dataset(episodes, names, about)


def intrinsics(folder: Path) -> list[float]:
    """Focal length, principal point right and down, and height of the left camera's pictures [px].

    Raises:
        ValueError: The dataset does not state them, or two cameras took its pictures.
    """
    file = folder / "meta" / "calibration" / "index.json"
    try:
        sets = json.loads(file.read_text("utf-8"))["sets"]
        models = [each["camera_info"]["endoscope_left"] for each in sets]
        found = [[m["K"][0], m["K"][2], m["K"][5], float(m["height"])] for m in models]
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise ValueError(f"{file}: no model of the left endoscope camera ({error!r})") from None
    if any(each != found[0] for each in found):
        raise ValueError(f"{file}: the pictures are of different cameras: {found}")
    return found[0]


def matrices(poses: Array, names: Sequence[str]) -> Array:
    """Poses (T, 7) with columns x, y, z, qx, qy, qz, qw in the order of ``names``, as (T, 4, 4)."""
    order = [[name.rpartition("/")[2] for name in names].index(n) for n in POSE]
    x, y, z, w = poses[:, order[3:]].T
    found = np.zeros((len(poses), 4, 4))
    found[:, :3, 3], found[:, 3, 3] = poses[:, order[:3]], 1.0
    found[:, 0, :3] = np.column_stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)]
    )
    found[:, 1, :3] = np.column_stack(
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)]
    )
    found[:, 2, :3] = np.column_stack(
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]
    )
    return found
