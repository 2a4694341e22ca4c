"""What a manifest states of the endoscope: calibration files as they are, lenses, joints to camera.

``surg_core`` checks the files. What it refuses is stated under ``problems`` and left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import surg_core
from surg_core.held_endoscope import LEFT, RIGHT, STEREO, held_endoscope

ENDOSCOPE_FILES = tuple(f"{name}.yaml" for name in (LEFT, RIGHT, STEREO))
ARM_FILES = ("tool", "trocar", "kinematics", "camera", "base")
"""Kinds of the files ``calibration/<kind>_<arm>.yaml``."""
MODEL_KEYS = ("width", "height", "distortion_model", "D", "K", "R", "P")
"""Of ``sensor_msgs/CameraInfo``."""


def calibration_files(folder: Path, arms: Iterable[str]) -> list[Path]:
    """The calibration files of a cell's folder that are there."""
    names = [*ENDOSCOPE_FILES, *(f"{kind}_{arm}.yaml" for arm in arms for kind in ARM_FILES)]
    return [path for name in names if (path := folder / "calibration" / name).is_file()]


def describe_endoscope(cell_file: Path) -> tuple[dict[str, Any] | None, list[str]]:
    """The held endoscope as numbers, None without one; and why it is not known.

    ``bases`` {arm: X_WB} are those of all arms, as they are believed.
    """
    try:
        cell = surg_core.load_cell(cell_file)
        held = held_endoscope(cell)
    except (surg_core.ConfigError, OSError) as problem:
        return None, [f"endoscope: {problem}"]
    if held is None:
        return None, []
    bases = {name: arm.X_WB.tolist() for name, arm in cell.arms.items()}
    return {**held.describe(), "bases": bases}, []


def camera_info_topic(topic: str) -> str:
    """The topic of a camera's model, beside that of its pictures."""
    root = topic.removesuffix("/compressed").removesuffix("/image_raw")
    return f"{root}/camera_info"


def camera_model(info: Any) -> dict[str, Any]:
    """A ``sensor_msgs/CameraInfo`` for the manifest."""
    model: Mapping[str, Any] = {key: getattr(info, key) for key in MODEL_KEYS}
    listed = {k: list(v) if isinstance(v, (list, tuple)) else v for k, v in model.items()}
    return {**listed, "frame_id": info.header.frame_id}
