"""A made-up dataset for the learned policy: a tip goes to a node, in the real one's numbers."""

from __future__ import annotations

import numpy as np

from surg_learn.bgr import observed_features, train_state
from surg_learn.bgr.training import action_head as action_head
from surg_learn.bgr.training import perceptron as perceptron
from surg_learn.cloning import arm_columns
from surg_learn.cloning.training import lerobot_dataset as lerobot_dataset

NODES = observed_features.NODES
STATE = [
    f"PSM1/{name}"
    for name in (
        *("tip_x", "tip_y", "tip_z", "roll", "jaw"),
        *("set_x", "set_y", "set_z", "roll_set"),
    )
]
TASK = [
    *("target", "held", "assistant_held"),
    *(
        f"{name}_{i}"
        for name in ("tip", "force", "assistant_tip", "assistant_force")
        for i in "012"
    ),
    *(f"assistant_joints_{i}" for i in range(4)),
    "assistant_jaw",
    *(f"X_WAssistant_{i}_{k}" for i in range(4) for k in range(4)),
    *("tension", "visible", "still", "slips"),
    *(f"nodes_{i}_{k}" for i in range(NODES) for k in range(3)),
]
ACTION = [f"PSM1/{name}" for name in ("x", "y", "z", "roll", "jaw")]


def episode(seed: int, steps: int = 60) -> train_state.Episode:
    """The tip goes a tenth of what is left to the asked node in every step; then the jaws close."""
    rng = np.random.default_rng(seed)
    nodes = np.cumsum(rng.normal([0.008, 0.0, 0.0], 0.004, (NODES, 3)), axis=0)
    nodes -= nodes.mean(axis=0)
    target = int(rng.integers(17, 23))
    tip, rows = rng.normal(0.0, 0.02, 3), []
    for step in range(steps):
        goal = tip + 0.1 * (nodes[target] - tip)
        jaw = 0.68 if step < steps // 2 else 0.0
        state = [*tip, 0.1, jaw, *tip, 0.1]
        held = float(target) if step > 0.7 * steps else -1.0
        task = dict.fromkeys(TASK, 0.0)
        task.update(target=float(target), held=held, assistant_held=-1.0)
        task.update({f"tip_{i}": tip[i] for i in range(3)})
        task.update({f"nodes_{i}_{k}": nodes[i, k] for i in range(NODES) for k in range(3)})
        rows.append((state, list(task.values()), [*goal, 0.1, jaw]))
        tip = goal
    return train_state.Episode(*(np.array(part) for part in zip(*rows, strict=True)))


def dataset(train: int = 6, val: int = 1, names: list[str] | None = None) -> train_state.Dataset:
    """Episodes with the seeds from 0 on."""
    found = [episode(seed) for seed in range(train + val)]
    return train_state.Dataset(
        {"train": found[:train], "val": found[train:]},
        {
            arm_columns.STATE: STATE,
            arm_columns.TASK: names or TASK,
            arm_columns.ACTION: ACTION,
        },
        {"fps": 20, "robot": "made up"},
    )
