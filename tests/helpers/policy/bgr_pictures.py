"""A made-up dataset for the policy that looks: a bright spot says where to go."""

from __future__ import annotations

import sys

import numpy as np

from helpers.policy.bgr_synthetic import ACTION, STATE
from surg_cli.host import paths

sys.path.insert(0, str(paths.ROOT / "examples/bgr"))

import bgr_image_policy
import train_bgr_images

SIDE = bgr_image_policy.SIDE
REACH = 0.03
"""From the middle of the picture to its edge [m]."""


def picture(goal: np.ndarray, tip: np.ndarray) -> np.ndarray:
    """The goal as a red spot, the tip as a green one, (SIDE, SIDE, 3)."""
    shown = np.full((SIDE, SIDE, 3), 60, np.uint8)
    for place, colour in ((goal, 0), (tip, 1)):
        row, column = np.clip((SIDE / 2) * (1 + place[:2] / REACH), 6, SIDE - 6).astype(int)
        shown[row - 5 : row + 5, column - 5 : column + 5, colour] = 240
    return shown


def episode(seed: int, steps: int = 50) -> train_bgr_images.Episode:
    """The tip goes a tenth of what is left to the spot in every step; then the jaws close."""
    rng = np.random.default_rng(seed)
    goal, tip = rng.uniform(-0.02, 0.02, 3), rng.uniform(-0.02, 0.02, 3)
    goal[2] = 0.1
    rows = []
    for step in range(steps):
        aim = tip + 0.1 * (goal - tip)
        jaw = 0.68 if step < 0.7 * steps else 0.0
        rows.append(([*tip, 0.1, jaw, *tip, 0.1], [*aim, 0.1, jaw], picture(goal, tip)))
        tip = aim
    state, action, views = zip(*rows, strict=True)
    return train_bgr_images.Episode(np.array(state), np.array(action), np.array(views))


def dataset(train: int = 6, val: int = 1) -> train_bgr_images.Dataset:
    """Episodes with the seeds from 0 on."""
    found = [episode(seed) for seed in range(train + val)]
    return train_bgr_images.Dataset(
        {"train": found[:train], "val": found[train:]},
        {bgr_image_policy.STATE: STATE, "action": ACTION},
        {"fps": 20, "robot": "made up"},
    )
