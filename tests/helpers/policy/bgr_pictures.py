"""A made-up dataset for the policy that looks: a bright spot says where to go."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from helpers.policy.bgr_synthetic import ACTION, STATE, TASK
from surg_learn.bgr import image_policy, keypoint_network, train_images
from surg_learn.bgr import picture_memory as picture_memory
from surg_learn.bgr.training import keypoint_labels as keypoint_labels
from surg_learn.bgr.training import keypoint_training as keypoint_training
from surg_learn.bgr.training import picture_dataset as picture_dataset
from surg_learn.cloning.small_pictures import SIDE as SIDE
from surg_learn.cloning.training import picture_augmentation as picture_augmentation

REACH = 0.03
"""From the middle of the picture to its edge [m]."""
DISTANCE = 0.1
"""From the camera to the plane of the goals [m]."""
K = [100.0, 0.0, 0.0, 2 * 100.0 * REACH / DISTANCE]
"""Focal length, principal point and height of the picture [px], so that `REACH` is at its edge."""


def picture(goal: np.ndarray, tip: np.ndarray) -> np.ndarray:
    """The goal as a red spot, the tip as a green one, (SIDE, SIDE, 3)."""
    shown = np.full((SIDE, SIDE, 3), 60, np.uint8)
    for place, colour in ((goal, 0), (tip, 1)):
        column, row = np.clip((SIDE / 2) * (1 + place[:2] / REACH), 6, SIDE - 6).astype(int)
        shown[row - 5 : row + 5, column - 5 : column + 5, colour] = 240
    return shown


def episode(seed: int, steps: int = 50) -> picture_dataset.Episode:
    """The tip goes a tenth of what is left to the spot in every step; then the jaws close.

    The camera looks along z. All nodes lie at the goal; so does the assistant's tip.
    """
    rng = np.random.default_rng(seed)
    goal, tip = rng.uniform(-0.02, 0.02, 3), rng.uniform(-0.02, 0.02, 3)
    goal[2] = tip[2] = DISTANCE
    rows = []
    for step in range(steps):
        aim = tip + 0.1 * (goal - tip)
        jaw = 0.68 if step < 0.7 * steps else 0.0
        task = dict.fromkeys(TASK, 0.0)
        task.update(target=18.0, held=-1.0 if jaw else 18.0, assistant_held=-1.0)
        for i, (g, p) in enumerate(zip(goal, tip, strict=True)):
            task.update({f"nodes_{n}_{i}": g for n in range(36)})
            task.update({f"assistant_tip_{i}": g, f"tip_{i}": p})
        state = [*tip, 0.1, jaw, *tip, 0.1]
        truth = [task[name] for name in TASK]
        rows.append((state, truth, [*aim, 0.1, jaw], np.eye(4), picture(goal, tip)))
        tip = aim
    parts = [np.array(part) for part in zip(*rows, strict=True)]
    return picture_dataset.Episode(*parts)


def dataset(train: int = 6, val: int = 1) -> train_images.Dataset:
    """Episodes with the seeds from 0 on."""
    found = [episode(seed) for seed in range(train + val)]
    return train_images.Dataset(
        {"train": found[:train], "val": found[train:]},
        {image_policy.STATE: STATE, train_images.TASK: TASK, "action": ACTION},
        {"fps": 20, "robot": "made up", "K": K},
    )


def eye(seed: int = 0, channels: int = 4, hidden: int = 8) -> keypoint_network.Eye:
    """An eye that was never trained: random weights."""
    rng = np.random.default_rng(seed)
    sizes = [3] + [channels] * len(keypoint_network.CONVOLUTIONS)
    shapes: list[tuple[int, ...]] = [
        (size, size, a, b)
        for (size, _, _), (a, b) in zip(
            keypoint_network.CONVOLUTIONS, itertools.pairwise(sizes), strict=True
        )
    ]
    maps = len(keypoint_network.MAPS)
    inputs = 2 * maps + channels * (1 + maps)
    shapes += [(channels, maps + 1), (inputs, hidden), (hidden, hidden), (hidden, 4)]
    layers = [
        (rng.normal(0, np.prod(s[:-1]) ** -0.5, s).astype(np.float32), np.zeros(s[-1], np.float32))
        for s in shapes
    ]
    return keypoint_network.Eye(layers, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))


def camera() -> tuple[np.ndarray, np.ndarray]:
    """`plane` and `lens` of the camera that takes the pictures."""
    plane = np.zeros((6, 3))
    plane[0, 2], plane[1, 1], plane[2, 0] = DISTANCE, REACH, REACH
    lens = np.zeros((3, 4))
    lens[0, 1] = lens[1, 0] = DISTANCE / REACH
    lens[2, 2] = 1.0
    return plane, lens


def dataset_folder(
    folder: Path,
    shape: Sequence[int] = (480, 640, 3),
    heights: Sequence[int] = (480,),
    focal: Sequence[float] = (450.0,),
    **info: Any,
) -> Path:
    """Metadata of a data set without rows; one set of calibration files for each ``heights``."""
    names = {
        image_policy.STATE: STATE,
        train_images.TASK: TASK,
        "action": ACTION,
        picture_dataset.CAMERA: list(picture_dataset.POSE),
    }
    features: dict[str, Any] = {key: {"names": value} for key, value in names.items()}
    features[image_policy.PICTURE] = {"shape": list(shape)}
    facts = {"features": features, "splits": {"train": "0:1"}, "fps": 20, "robot_type": "ur5e"}
    (folder / "meta" / "calibration").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps({**facts, **info}), "utf-8")
    sets = []
    for height, f in zip(heights, focal, strict=True):
        K = [f, 0.0, 320.0, 0.0, f, height / 2, 0.0, 0.0, 1.0]
        sets.append({"camera_info": {"endoscope_left": {"K": K, "height": height}}})
    index = folder / "meta" / "calibration" / "index.json"
    index.write_text(json.dumps({"sets": sets}), "utf-8")
    return folder
