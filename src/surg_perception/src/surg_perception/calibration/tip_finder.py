"""Finds an instrument's tip in pairs of pictures of a still scene.

The endoscope rests while the instrument goes from place to place. What differs from the median of
all pictures is the instrument; its far end along the shaft is the tip. The shaft's direction comes
from the joints and the believed bases: a few degrees of error do not matter. The depth is that at
which the instrument's surface before the left eye looks alike in the right one: a plane that holds
the shaft's direction, so that the slanted shaft does not pull the tip's depth along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from surg_core.transforms import FloatArray, inverse_pose
from surg_perception.calibration.small_motions import transform
from surg_perception.calibration.triangulation import Stereo

Picture = NDArray[np.uint8]
Smooth = NDArray[np.float32]
Mask = NDArray[np.bool_]

CHANGED = 12.0
"""[grey levels] Least change of the instrument against what is behind it."""
LEAST_AREA = 0.002
"""Least area of the instrument, as a share of the picture."""
PATCH = 0.08
"""Radius around the tip in which the eyes are compared, as a share of the picture's height."""
MOST_PIXELS = 3000
"""Pixels around the tip that are compared."""
END = 3.0
"""[px] Length of the far end whose middle is the tip."""
RIM = 0.02
"""A tip this near to the edge of the lit picture is cut off; a share of the picture's height."""
DEPTHS = (0.03, 0.2)
"""[m] Range of the search."""
STEP = 0.5
"""[px] Step of the search in the right picture."""
ALIKE = 0.6
"""Least correlation of both eyes."""
LIT = 12.0
"""[grey levels] A darker pixel in all pictures lies outside the round picture."""


class NotSeen(ValueError):
    """The tip is not found in a view; the message states why and what to do."""


@dataclass(frozen=True)
class TipScene:
    """What all views share.

    Attributes:
        behind: ``(h, w, 3)`` the scene without the instrument, of the left eye.
        lit: ``(h, w)`` the illuminated part of the picture.
        noise: Typical change of a pixel that shows the scene [grey levels].
    """

    behind: Smooth
    lit: Mask
    noise: float

    @classmethod
    def of(cls, left: Sequence[Picture]) -> TipScene:
        """From the left pictures (h, w, 3) of all views."""
        smooth = np.array([_smooth(picture) for picture in left])
        behind = np.median(smooth, axis=0).astype(np.float32)
        noise = float(np.median(np.abs(smooth - behind).max(axis=3)))
        lit = (smooth.max(axis=(0, 3)) > LIT).astype(np.uint8)
        closed = cv2.morphologyEx(lit, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
        return cls(behind, closed.astype(bool), noise)


def find_tip(
    scene: TipScene, pair: tuple[Picture, Picture], eyes: Stereo, s_V: FloatArray
) -> FloatArray:
    """The tip (3,) before the left eye [m].

    Args:
        scene: Of all views.
        pair: Left and right picture (h, w, 3).
        eyes: Both lenses and the pose between them.
        s_V: (3,) direction of the shaft towards its tip, roughly.

    Raises:
        NotSeen: It is hidden, outside the picture, or the eyes disagree.
    """
    instrument = _instrument(scene, pair[0])
    tip = _far_end(instrument, _in_picture(eyes, instrument, s_V))
    height, width = instrument.shape
    inside = cv2.distanceTransform(np.pad(scene.lit, 1).astype(np.uint8), cv2.DIST_L2, 5)
    column, row = np.clip(np.round(tip).astype(int), 0, [width - 1, height - 1])
    if inside[row + 1, column + 1] < RIM * height:
        raise NotSeen("the tip leaves the picture; move it towards the middle")
    y, x = np.nonzero(instrument)
    near = np.hypot(x - tip[0], y - tip[1]) < PATCH * height
    pixels = np.column_stack([x[near], y[near]]).astype(np.float64)
    pixels = pixels[:: 1 + len(pixels) // MOST_PIXELS]
    return _depth(pair, eyes, tip, pixels, s_V)


def _smooth(picture: Picture) -> Smooth:
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0))


def _instrument(scene: TipScene, picture: Picture) -> Mask:
    """The pixels (h, w) of the instrument."""
    change = np.abs(_smooth(picture) - scene.behind).max(axis=2)
    changed = ((change > max(CHANGED, 8.0 * scene.noise)) & scene.lit).astype(np.uint8)
    changed = cv2.morphologyEx(changed, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    joined = cv2.morphologyEx(changed, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    count, parts, stats, _ = cv2.connectedComponentsWithStats(joined)
    areas = stats[1:, cv2.CC_STAT_AREA] if count > 1 else np.zeros(1)
    if areas.max() < LEAST_AREA * picture.shape[0] * picture.shape[1]:
        raise NotSeen(
            "no instrument is seen; move its tip into the picture, and to another place in each "
            "view, while the endoscope rests"
        )
    return np.asarray((parts == 1 + int(areas.argmax())) & joined.astype(bool))


def _in_picture(eyes: Stereo, instrument: Mask, s_V: FloatArray) -> FloatArray:
    """Direction (2,) of the shaft in the left picture, towards its tip."""
    y, x = np.nonzero(instrument)
    middle = np.array([[x.mean(), y.mean()]])
    p = 0.08 * eyes.left.rays(middle)
    ends = eyes.left.project(np.concatenate([p - 0.005 * s_V, p + 0.005 * s_V]))
    along = ends[1] - ends[0]
    if not np.linalg.norm(along) > 1.0:
        raise NotSeen("the shaft points along the view; look at it from the side")
    return np.asarray(along / np.linalg.norm(along))


def _far_end(instrument: Mask, along: FloatArray) -> FloatArray:
    """The end (2,) of the instrument in a direction [px]; the direction is refined by its shape."""
    y, x = np.nonzero(instrument)
    points = np.column_stack([x, y]).astype(np.float64)
    for _ in range(2):
        away = points @ along
        near = points[away > away.max() - PATCH * instrument.shape[0]]
        _, axes = np.linalg.eigh(np.cov((near - near.mean(axis=0)).T))
        axis = axes[:, 1] * np.sign(axes[:, 1] @ along)
        if axis @ along > 0.8:  # otherwise the end is too short to show its direction
            along = axis
    away = points @ along
    return np.asarray(points[away >= away.max() - END].mean(axis=0))


def _depth(
    pair: tuple[Picture, Picture],
    eyes: Stereo,
    tip: FloatArray,
    pixels: FloatArray,
    s_V: FloatArray,
) -> FloatArray:
    """The point (3,) on the ray of the tip at which both eyes agree [m]."""
    left, right = (_smooth(picture) for picture in pair)
    ray, rays = eyes.left.rays(tip[None])[0], eyes.left.rays(pixels)
    # The plane through the shaft that faces the eye.
    normal = ray - (ray @ s_V) * s_V
    if np.linalg.norm(normal) < 0.1:
        raise NotSeen("the shaft points along the view; look at it from the side")
    share = (ray @ normal) / (rays @ normal)
    good = np.isfinite(share) & (share > 0.5) & (share < 2.0)
    surface = share[good, None] * rays[good]
    columns, rows = pixels[good].astype(int).T
    look = left[rows, columns]
    X_RL = inverse_pose(eyes.X_LR)

    def alike(depth: float) -> float:
        at = eyes.right.project(transform(X_RL, depth * surface)).astype(np.float32)
        seen = cv2.remap(right, at[None, :, 0], at[None, :, 1], cv2.INTER_CUBIC)[0]
        return _correlation(look, seen)

    disparity = eyes.left.values[0] * eyes.baseline
    steps = np.arange(disparity / DEPTHS[1], disparity / DEPTHS[0], STEP)
    scores = np.array([alike(disparity / d) for d in steps])
    for fine in (0.1, 0.02):
        middle = steps[int(np.argmax(scores))]
        width = 1.2 * (steps[1] - steps[0])
        steps = np.arange(middle - width, middle + width, fine)
        scores = np.array([alike(disparity / d) for d in steps])
    best = int(np.argmax(scores))
    if scores[best] < ALIKE:
        raise NotSeen(
            f"both eyes disagree about the tip (correlation {scores[best]:.2f}, at least {ALIKE}); "
            "is it hidden, or does the endoscope move?"
        )
    return np.asarray(disparity / steps[best] * ray)


def _correlation(a: Smooth, b: Smooth) -> float:
    """Normalised correlation of two sets of colours (n, 3)."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    return float((a * b).sum() / max(float(np.sqrt((a * a).sum() * (b * b).sum())), 1e-6))
