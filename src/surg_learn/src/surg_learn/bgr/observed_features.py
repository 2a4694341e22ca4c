"""What the policies read: columns by name, and features of the simulator's truth.

Numpy only. All features are in the rcm frame, as the actions are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from surg_learn.cloning.arm_columns import SET, TASK, Array, columns_of, state_columns

BESIDE = 8
"""Distance in nodes from the requested one to a resting one, which shows how far it was lifted."""
LAGS = (0, 4, 8, 16)
"""Steps back at which the slow features are sampled; they show when a state changed."""
ROBOT = "PSM1"
NODES = 36
"""Nodes of the bowel."""
PLACES, DISTANCE, HERE = slice(0, 9), 9, slice(-3, None)
"""Columns of the features: vectors from the last command to the requested node, the assistant and a
resting node; the length of the first; the last command."""


class Columns:
    """Finds columns by their names; no order is assumed.

    Args:
        state: Names of the numbers of `observation.state`.
        task: Names of the numbers of `privileged.task_state`.

    Raises:
        ValueError: A required name is missing.
    """

    def __init__(self, state: Sequence[str], task: Sequence[str]) -> None:
        self.state = state_columns(state, ROBOT)
        self.task = {
            name: columns_of(TASK, task, [name])[0]
            for name in ("target", "held", "assistant_held", "assistant_jaw", "tension", "visible")
        }
        for name in ("tip", "assistant_tip"):
            self.task[name] = columns_of(TASK, task, [f"{name}_{i}" for i in range(3)])
        flat = [f"nodes_{i}_{k}" for i in range(NODES) for k in range(3)]
        self.task["nodes"] = columns_of(TASK, task, flat)


def features(columns: Columns, state: Array, task: Array, last: Array, X_RW: Array) -> Array:
    """Inputs of the network at each of T successive steps of one episode.

    All are in the rcm frame: vectors from the last command to points, grasps as numbers, the slow
    features at earlier steps (`LAGS`). The origin is the last command: the set-point runs ahead of
    a moving stream, so "stay at the set-point" would make the arm drift.

    Args:
        columns: Of the observations.
        state: (T, 9) `observation.state`.
        task: (T, 148) `privileged.task_state`.
        last: (T, 4) tip and roll of the last command; at the first step, the set-point.
        X_RW: (4, 4) pose of the world in the rcm frame, see `world_in_rcm`.

    Returns:
        (T, F). `PLACES` are vectors from the last command, the first one `DISTANCE` long; `HERE` is
        the last command.
    """
    s = state[:, columns.state]
    z = {name: task[:, index] for name, index in columns.task.items()}
    nodes = z["nodes"].reshape(len(task), NODES, 3)
    row, here = np.arange(len(task)), last[:, :3]
    i = np.clip(np.rint(z["target"]).astype(int), 1, NODES - 2)

    def to(p_W: np.ndarray) -> np.ndarray:
        return p_W @ X_RW[:3, :3].T + X_RW[:3, 3] - here

    along = (nodes[row, i + 1] - nodes[row, i - 1]) @ X_RW[:3, :3].T
    beside = nodes[row, np.minimum(i + BESIDE, NODES - 1)]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    target, helper = to(nodes[row, i]), to(z["assistant_tip"])
    held, assistant_held = (z[name] >= 0 for name in ("held", "assistant_held"))
    pointing = np.linalg.norm(helper - target, axis=1)
    # A held node moves with the jaws: it is no target.
    target[held], along[held], pointing[held] = 0.0, 0.0, 0.0
    now = [
        target,
        helper,
        to(beside),
        np.linalg.norm(target, axis=1),
        along,
        s[:, :3] - here,
        s[:, SET][:, :3] - here,
        s[:, [3, 4, 8]],
        last[:, 3],
        z["assistant_jaw"],
        z["tension"],
        z["visible"],
    ]
    slow = np.column_stack([held, assistant_held, pointing])
    return np.column_stack([*now, *(slow[np.maximum(row - lag, 0)] for lag in LAGS), here])


def world_in_rcm(p_R: np.ndarray, p_W: np.ndarray) -> np.ndarray:
    """The rigid motion that best maps world points to the rcm frame (Kabsch 1976).

    Args:
        p_R: (N, 3) tip of `observation.state` [m].
        p_W: (N, 3) tip of `privileged.task_state` [m].

    Returns:
        (4, 4) X_RW.
    """
    middle_R, middle_W = p_R.mean(axis=0), p_W.mean(axis=0)
    U, _, Vt = np.linalg.svd((p_R - middle_R).T @ (p_W - middle_W))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, middle_R - R @ middle_W
    return X


class Told(Protocol):
    """An episode of T steps with the simulator's truth."""

    state: Array
    task: Array


def world_of(episodes: Sequence[Told], columns: Columns) -> Array:
    """X_RW (4, 4) from the tips of all episodes, see `world_in_rcm`."""
    tips = [episode.state[:, columns.state[:3]] for episode in episodes]
    tips_W = [episode.task[:, columns.task["tip"]] for episode in episodes]
    return world_in_rcm(np.concatenate(tips), np.concatenate(tips_W))
