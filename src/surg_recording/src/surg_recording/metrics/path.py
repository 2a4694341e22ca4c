"""Path length of the tip, sweep of the shaft, and idle time."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy import spatial

from surg_recording.metrics._types import Array, ArrayLike, finite, positive, rows3
from surg_recording.metrics.filters import low_pass


def path_length(position: ArrayLike, fs: float | None = None, cutoff: float | None = None) -> float:
    """Length of a path (N, 3) [m].

    With ``cutoff`` [Hz] and ``fs`` [Hz] the path is low-passed first (zero-phase Butterworth, order
    4), because tremor adds length without travel.
    """
    p = rows3(position, "path_length: position")
    if cutoff is not None:
        if fs is None:
            raise ValueError("path_length: a cutoff needs fs")
        p = low_pass(p, fs, cutoff)
    return float(np.sum(np.linalg.norm(np.diff(p, axis=0), axis=1)))


IDLE_BELOW = 1e-3
"""Speed below which a tip counts as still [m/s]."""
IDLE_AT_LEAST = 0.5
"""A shorter pause is a turning point, not idle time [s]."""


@dataclasses.dataclass(frozen=True)
class Idle:
    """Idle time of a tip."""

    seconds: float
    share: float
    """Fraction of the whole duration."""
    pauses: int


def idle(position: ArrayLike, fs: float, cutoff: float = 3.0) -> Idle:
    """Time in which the tip stands still: pauses in which its speed stays below a bound.

    Args:
        position: (N, 3) tip positions on a uniform grid [m].
        fs: Its rate [Hz].
        cutoff: Zero-phase low-pass before differentiating [Hz]; tremor in place counts as still.

    Raises:
        ValueError: A wrong shape, a non-finite value, or a parameter that is not positive.
    """
    p = finite(rows3(position, "idle: position"), "idle: position")
    for value, name in ((fs, "fs"), (cutoff, "cutoff")):
        positive(value, f"idle: {name}")
    if len(p) < 2:
        return Idle(0.0, 0.0, 0)
    # Speeds of the N - 1 steps, so that the pauses and the motion add up to the duration.
    step = np.linalg.norm(np.diff(low_pass(p, fs, cutoff), axis=0), axis=1) * fs
    still = np.concatenate([[False], step < IDLE_BELOW, [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    lengths = (edges[1::2] - edges[::2]) / fs
    counted = lengths[lengths >= IDLE_AT_LEAST - 0.5 / fs]
    seconds = float(np.sum(counted))
    return Idle(seconds, seconds * fs / (len(p) - 1), len(counted))


def shaft_sweep(s_B: ArrayLike) -> float:
    """Largest angle between any two shaft directions (N, 3) of a run [rad].

    Exact: directions within a half-sphere are projected to the plane along great circles, where the
    two farthest lie on the convex hull.
    """
    s = rows3(s_B, "shaft_sweep: s_B")
    s = s[np.all(np.isfinite(s), axis=1)]
    if len(s) < 2:
        return 0.0
    s = s / np.linalg.norm(s, axis=1, keepdims=True)
    candidates = _extreme_directions(s)
    best = 0.0
    for block in np.array_split(candidates, max(1, len(candidates) // 512)):
        chord = spatial.distance.cdist(block, candidates)
        best = max(best, float(np.max(chord)))
    return 2.0 * math.asin(min(1.0, best / 2.0))


def _extreme_directions(s: Array) -> Array:
    """The unit vectors that can be an end of the largest angle."""
    mean = s.mean(axis=0)
    if np.linalg.norm(mean) < 1e-6:
        return s
    mean /= np.linalg.norm(mean)
    cosine = s @ mean
    if np.min(cosine) < 0.05:  # not well inside one half-sphere
        return s
    u = np.cross(mean, np.eye(3)[np.argmin(np.abs(mean))])
    u /= np.linalg.norm(u)
    plane = np.stack([s @ u, s @ np.cross(mean, u)], axis=1) / cosine[:, None]
    try:
        return np.asarray(s[spatial.ConvexHull(plane).vertices])
    except spatial.QhullError:  # all on one line: the ends of that line
        _, _, rows = np.linalg.svd(plane - plane.mean(axis=0), full_matrices=False)
        along = plane @ rows[0]
        return np.asarray(s[[int(np.argmin(along)), int(np.argmax(along))]])
