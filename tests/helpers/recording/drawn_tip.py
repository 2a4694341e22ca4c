"""Where the tip of an instrument is in exported pictures, by the data set's own calibration."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pyarrow import parquet

from surg_core.transforms import inverse_pose, make_pose

Array = npt.NDArray[np.float64]

EYES = {"observation.images.endoscope.left": "endoscope_left",
        "observation.images.endoscope.right": "endoscope_right"}  # fmt: skip
"""Feature of a picture → camera."""


def tip_pixels(dataset: Path, arm: str, feature: str) -> Array:
    """The tip of an arm in each picture of the first episode of a LeRobot 2.1 data set.

    Returns:
        (frames, 2) pixels from the centre of the upper left one.
    """
    info = json.loads((dataset / "meta/info.json").read_text("utf-8"))
    index = json.loads((dataset / "meta/calibration/index.json").read_text("utf-8"))
    calibration = index["sets"][index["episodes"][0]]
    names = info["features"]["observation.cartesian_state"]["names"]
    place = names.index(f"{arm}/x")

    table = parquet.read_table(next((dataset / "data").rglob("episode_000000.parquet")))
    state = np.array(table["observation.cartesian_state"].to_pylist())
    camera = np.array(table["observation.camera_pose"].to_pylist())
    X_WB = np.array(calibration["endoscope"]["bases"][arm])
    p_WTip = state[:, place : place + 3] @ X_WB[:3, :3].T + X_WB[:3, 3]
    X_LEye = np.eye(4)
    if EYES[feature] == "endoscope_right":
        X_LEye = np.array(calibration["endoscope"]["X_LR"])
    p_Eye = []
    for seven, p_W in zip(camera, p_WTip, strict=True):
        X_EyeW = inverse_pose(make_pose(seven[:3], seven[3:]) @ X_LEye)
        p_Eye.append(X_EyeW[:3, :3] @ p_W + X_EyeW[:3, 3])
    return project(np.array(p_Eye), calibration["camera_info"][EYES[feature]])


def project(points: Array, model: Mapping[str, Any]) -> Array:
    """Points (n, 3) [m] of the camera's optical frame as pixels (n, 2) of its raw picture."""
    K, D = np.array(model["K"]).reshape(3, 3), np.array(model["D"], dtype=np.float64)
    still = np.zeros(3)
    if model["distortion_model"] == "equidistant":
        found, _ = cv2.fisheye.projectPoints(points[:, None], still, still, K, D)
    else:
        found, _ = cv2.projectPoints(points, still, still, K, D)
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)
