"""What the keypoint network learns to see, from the simulator's truth; used by `train_images.py`.

Labels come from `privileged.task_state`, and are used here only. Of a real robot's pictures a
person could mark most of them: the requested place, both tips, who holds the bowel. Points in space
would then need two eyes or a depth camera. The tension only a simulator knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surg_learn.bgr.keypoint_network import CELLS, grid, square
from surg_learn.bgr.observed_features import NODES
from surg_learn.cloning.arm_columns import Array
from surg_learn.cloning.training.lerobot_dataset import RATE

HEAT = 1.0
"""Standard deviation of a heat map's target [cells]."""
MOST_TENSION = 1.5
"""Larger tensions are all alike [N]."""
POINT_AT, POINT_SPEED, POINT_JAW = 0.025, 0.004, 0.1
"""An assistant points from at most so far [m], so slowly [m/s], with jaws so shut [rad]."""


@dataclass
class Labels:
    """What is to be found in N pictures.

    Attributes:
        points: (N, 3) the requested node in the rcm frame [m].
        marks: (N, 38, 2) the assistant's tip, the robot's tip and the bowel's nodes in the picture,
            down and right, -1 to 1 in the middle square.
        others: (N, 4) whether the robot and the assistant hold the bowel, the assistant's jaw angle
            [rad], the tension [N].
        rest: (N, 36, 3) the nodes in the rcm frame [m].
        free: (N,) whether nobody has touched the bowel.
        pointing: (N,) whether the assistant points.
        target: (N,) number of the requested node.
    """

    points: Array
    marks: Array
    others: Array
    rest: Array
    free: Array
    pointing: Array
    target: Array


def labels(
    task: Array, columns: dict[str, Array], X_RW: Array, X_WV: Array, K: Sequence[float]
) -> Labels:
    """Labels of T steps of an episode.

    Args:
        task: (T, n) `privileged.task_state`.
        columns: Of its parts, see `state_policy.Columns`.
        X_RW: (4, 4) pose of the world in the rcm frame.
        X_WV: (T, 4, 4) pose of the camera (x right, y down, z away).
        K: (4,) focal length, principal point right and down, and height of the picture [px].
    """
    T = len(task)
    nodes = task[:, columns["nodes"]].reshape(T, NODES, 3)
    row = np.arange(T)
    i = np.rint(task[:, columns["target"]]).astype(int).ravel()
    helper = task[:, columns["assistant_tip"]]
    p_W = np.concatenate([helper[:, None], task[:, None, columns["tip"]], nodes], axis=1)
    p_V = np.einsum("tji,tpj->tpi", X_WV[:, :3, :3], p_W - X_WV[:, None, :3, 3])
    # The middle of the picture is the principal point.
    places = K[0] * p_V[..., :2] / np.maximum(p_V[..., 2:], 1e-3) / (K[3] / 2)
    rest = nodes @ X_RW[:3, :3].T + X_RW[:3, 3]
    held = task[:, [*columns["held"].ravel(), *columns["assistant_held"].ravel()]] >= 0
    jaw = task[:, columns["assistant_jaw"]].ravel()
    tension = np.minimum(task[:, columns["tension"]].ravel(), MOST_TENSION)
    speed = np.linalg.norm(np.diff(helper, axis=0, prepend=helper[:1] + 1.0), axis=1) * RATE
    away = np.linalg.norm(helper - nodes[row, i], axis=1)
    return Labels(
        rest[row, i],
        places[..., ::-1],
        np.column_stack([held, jaw, tension]),
        rest,
        ~np.maximum.accumulate(held.any(axis=1)),
        (away < POINT_AT) & (speed < POINT_SPEED) & (jaw < POINT_JAW),
        i,
    )


def heats(marks: Array) -> Array:
    """Targets of the heat maps, (B, CELLS * CELLS, M): a Gaussian about each mark, of sum 1.

    A mark outside the picture has a map of zeros.
    """
    away: Array = grid(CELLS)[None, :, None, :] - marks[:, None, :, :].astype(np.float32)
    step = 2.0 / (CELLS - 1)
    heat = np.exp(-0.5 * (away**2).sum(axis=3) / (HEAT * step) ** 2)
    total = heat.sum(axis=1, keepdims=True)
    return np.where(total > 1.0, heat / np.maximum(total, 1e-9), 0.0).astype(np.float32)


def tubes(nodes: Array) -> Array:
    """Targets of the map of the tube, (B, CELLS * CELLS): 1 on its axis, a Gaussian across.

    Args:
        nodes: (B, 36, 2) marks of the nodes.
    """
    between = 0.5 * (nodes[:, 1:] + nodes[:, :-1])
    marks = np.concatenate([nodes, between], axis=1).astype(np.float32)
    cells = grid(CELLS)
    square_away = (
        (cells**2).sum(axis=1)[None, :, None]
        + (marks**2).sum(axis=2)[:, None, :]
        - 2.0 * np.einsum("cd,bmd->bcm", cells, marks)
    )
    step = 2.0 / (CELLS - 1)
    return np.exp(-0.5 * square_away.min(axis=2) / (HEAT * step) ** 2).astype(np.float32)


def plane_of(labels: Labels) -> Array:
    """`plane` of a `View`, by least squares over the nodes of a bowel that nobody has touched."""
    free = labels.free & (np.arange(len(labels.free)) % 5 == 0)
    inside = (np.abs(labels.marks[free, 2:]) < 1.0).all(axis=2)
    terms = square(labels.marks[free, 2:][inside])
    return np.asarray(np.linalg.lstsq(terms, labels.rest[free][inside], rcond=None)[0])


def pointed_of(labels: Labels) -> Array:
    """`pointed` of an `Eye`, by least squares.

    Raises:
        ValueError: Nobody points in any picture.
    """
    shown = np.flatnonzero(labels.pointing & labels.free)
    if len(shown) < 3:
        raise ValueError("the assistant points in no picture of the dataset")
    terms = np.column_stack([np.ones(len(shown)), labels.marks[shown, 0]])
    places = labels.marks[shown, 2 + labels.target[shown]]
    return np.asarray(np.linalg.lstsq(terms, places, rcond=None)[0])


def lens_of(points: Array, places: Array) -> Array:
    """The camera from points and where they are seen: direct linear transformation.

    Args:
        points: (N, 3) [m].
        places: (N, 2) down and right; those outside the picture are left out.

    Returns:
        (3, 4) homogeneous projection.
    """
    seen = (np.abs(places) < 1.0).all(axis=1)
    points, places = points[seen], places[seen]
    middle, spread = points.mean(axis=0), points.std()
    X = np.column_stack([(points - middle) / spread, np.ones(len(points))])
    zero = np.zeros_like(X)
    rows = np.concatenate(
        [
            np.column_stack([X, zero, -places[:, :1] * X]),
            np.column_stack([zero, X, -places[:, 1:] * X]),
        ]
    )
    P = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 4)
    to = np.eye(4)
    to[:3] = np.column_stack([np.eye(3), -middle]) / spread
    P = P @ to
    return np.asarray(P / (P @ np.append(middle, 1.0))[2])
