"""Finds an instrument's shaft near the place where its joints put it.

The picture is unrolled along the axis that the joints predict: a row for each of its points, a
column for each pixel across. There the shaft is a straight bar, darker or brighter than both its
sides. A search over offset, slant and width finds it; its two edges then say where its axis is to a
fraction of a pixel. Nothing is learned, and nothing but the shaft need be known.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from surg_core.transforms import FloatArray
from surg_perception.calibration.tip_finder import LIT, Mask, NotSeen

Grey = NDArray[np.float32]

REACH = 120
"""[px] Farthest offset that is searched, in a picture of 640 pixels."""
SLANTS = np.tan(np.radians(np.arange(-12.0, 12.1, 4.0)))
"""Slants of the seen axis against the predicted one that are tried."""
WIDTHS = (0.55, 0.7, 0.85, 1.0)
"""Half widths that are tried, as shares of the predicted one: a capsule holds the jaw too."""
COARSE = 0.25
"""Size of the picture in which the round edge is looked for, relative."""
CONTRAST = 5.0
"""[grey levels] Least difference between the shaft and both its sides."""
EDGE = 2.0
"""[grey levels/px] Least slope of an edge."""
LEAST_ROWS = 14
"""Rows in which both edges must be seen."""
STRAIGHT = 0.8
"""[px] Largest scatter of the rows of a shaft; what is behind it scatters more."""
RIVAL = 0.85
"""Another bar with this share of the best one's contrast: which of them is the shaft?"""
BLUR = 0.15
"""[px] Least scatter of a row's axis: an edge is no better than that."""


@dataclass(frozen=True)
class ShaftSeen:
    """Two places of the predicted axis, and how far beside them the axis is seen.

    Attributes:
        at: (2,) places, as positions in the list of predicted points.
        normals: (2, 2) directions across the axis in the picture.
        offsets: (2,) along the normals [px]; their errors are independent.
        sd: One sigma of either offset [px], of the rows' scatter alone.
        width: Of the shaft, as a share of the predicted one.
    """

    at: FloatArray
    normals: FloatArray
    offsets: FloatArray
    sd: float
    width: float


@dataclass(frozen=True)
class _Strip:
    """The picture unrolled along the predicted axis.

    Attributes:
        grey: (n, m) grey levels; the middle column is the predicted axis.
        lit: (n, m) what lies inside the round picture.
        s: (n,) way along the axis, from its middle [px].
        normals: (n, 2) across it.
        half: Predicted half width [px].
        first: Number of the first predicted point.
    """

    grey: Grey
    lit: Mask
    s: FloatArray
    normals: FloatArray
    half: float
    first: int


def lit_part(grey: Grey) -> Mask:
    """The round picture (h, w) without its edge: the hull of what is lit."""
    small = cv2.resize(grey, None, fx=COARSE, fy=COARSE, interpolation=cv2.INTER_AREA)
    mask = np.zeros(small.shape, np.uint8)
    points = cv2.findNonZero((small > LIT).astype(np.uint8))
    if points is not None:
        cv2.fillConvexPoly(mask, cv2.convexHull(points), 1)
    inner = cv2.erode(mask, np.ones((5, 5), np.uint8), borderValue=0)
    size = grey.shape[1], grey.shape[0]
    return cv2.resize(inner, size, interpolation=cv2.INTER_NEAREST).astype(bool)


def find_shaft(grey: Grey, lit: Mask, axis: FloatArray, half: FloatArray) -> ShaftSeen:
    """The shaft in one picture.

    Args:
        grey: (h, w) the picture.
        lit: (h, w) as `lit_part` gives it.
        axis: (n, 2) pixels of points of the predicted axis, in order; NaN: not before the eye.
        half: (n,) predicted half widths [px].

    Raises:
        NotSeen: It is outside the picture, hidden, without contrast, or one of two.
    """
    strip = _unroll(grey, lit, axis, half)
    offset, slant, width = _bar(strip)
    return _refined(strip, offset + slant * strip.s, width)


def _unroll(grey: Grey, lit: Mask, axis: FloatArray, half: FloatArray) -> _Strip:
    seen = np.flatnonzero(np.isfinite(axis).all(axis=1))
    if len(seen) < LEAST_ROWS:
        raise NotSeen("the shaft is not before the eye")
    axis, half = axis[seen], half[seen]
    along = np.gradient(axis, axis=0)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    if length.min() < 1e-3:
        raise NotSeen("the shaft points along the view")
    normals = np.column_stack([-along[:, 1], along[:, 0]]) / length
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))])
    reach = round(REACH * grey.shape[1] / 640)
    across = np.arange(-reach, reach + 1)
    at = (axis[:, None] + across[None, :, None] * normals[:, None]).astype(np.float32)
    unrolled = cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    inside = cv2.remap(lit.astype(np.uint8), at[..., 0], at[..., 1], cv2.INTER_NEAREST) > 0
    return _Strip(unrolled, inside, s - s.mean(), normals, float(half.mean()), int(seen[0]))


def _bar(strip: _Strip) -> tuple[float, float, float]:
    """Offset [px], slant and half width [px] of the bar with most contrast."""
    n, m = strip.grey.shape
    sums = np.pad(np.cumsum(strip.grey, axis=1, dtype=np.float64), ((0, 0), (1, 0)))
    columns = np.arange(m)
    sheared = [
        m * np.arange(n)[:, None]
        + np.clip(columns + np.round(slant * strip.s)[:, None].astype(int), 0, m - 1)
        for slant in SLANTS
    ]
    rows = [np.take(strip.lit, index).sum(axis=0) for index in sheared]
    scores = []
    for share in WIDTHS:
        alike = _contrast(sums, max(2, round(share * strip.half))) * strip.lit
        for index, lit in zip(sheared, rows, strict=True):
            total = np.abs(np.take(alike, index).sum(axis=0))
            # A bar of few rows counts less: a short one is found anywhere.
            scores.append(np.where(lit >= LEAST_ROWS, total / np.maximum(lit, 0.5 * n), 0.0))
    table = np.array(scores)
    best, column = np.unravel_index(int(table.argmax()), table.shape)
    if table[best, column] < CONTRAST:
        raise NotSeen("no shaft stands out from what is behind it")
    share, slant = WIDTHS[best // len(SLANTS)], SLANTS[best % len(SLANTS)]
    elsewhere = np.abs(columns - column) > 2.5 * strip.half
    if elsewhere.any() and table[:, elsewhere].max() > RIVAL * table[best, column]:
        raise NotSeen("two shafts are in question")
    return float(column - m // 2), float(slant), share * strip.half


def _contrast(sums: FloatArray, half: int) -> FloatArray:
    """How much a bar of this half width differs from both sides, by row and column."""
    m = sums.shape[1] - 1
    beside = max(2, half // 2)

    def mean(first: int, last: int) -> FloatArray:
        low = np.clip(np.arange(m) + first, 0, m)
        high = np.clip(np.arange(m) + last + 1, 0, m)
        return np.asarray((sums[:, high] - sums[:, low]) / np.maximum(high - low, 1))

    inside = mean(1 - half, half - 1)
    left = mean(-half - beside, -half - 1) - inside
    right = mean(half + 1, half + beside) - inside
    least = np.minimum(np.minimum(np.abs(left), np.abs(right)), 10.0 * CONTRAST)
    alike = np.where(left * right > 0.0, np.sign(left) * least, 0.0)
    edge = half + beside  # nearer to the strip's end nothing is known of one side
    alike[:, :edge] = alike[:, m - edge :] = 0.0
    return alike


def _refined(strip: _Strip, line: FloatArray, half: float) -> ShaftSeen:
    """The axis between both edges, from all rows in which both are seen."""
    smooth = cv2.GaussianBlur(strip.grey, (0, 0), 1.0)
    slope = np.abs(np.gradient(smooth, axis=1))
    X = np.column_stack([np.ones_like(strip.s), strip.s])
    for reach in (0.5, 0.3, 0.25):  # of the half width, around the edges found before
        edges = [_edge(strip, slope, line + side * half, reach * half) for side in (-1, 1)]
        (left, good_left), (right, good_right) = edges
        good = good_left & good_right
        if good.sum() < LEAST_ROWS:
            raise NotSeen("the shaft's edges are hidden")
        middle, width = 0.5 * (left + right), 0.5 * (right - left)
        good &= np.abs(width - np.median(width[good])) < 0.25 * half + 1.0
        fit, scatter, kept = _robust(X, middle, good)
        line, half = X @ fit, float(np.median(width[good]))
    s = strip.s[kept]
    mean, spread = float(s.mean()), float(s.std())
    places = mean + spread * np.array([-1.0, 1.0])
    order = np.arange(len(strip.s))
    at: FloatArray = np.interp(places, strip.s, order).astype(np.float64)
    nearest = np.round(at).astype(int)
    return ShaftSeen(
        strip.first + at,
        strip.normals[nearest],
        fit[0] + fit[1] * places,
        scatter * np.sqrt(2.0 / len(s)),
        half / strip.half,
    )


def _edge(
    strip: _Strip, slope: FloatArray, near: FloatArray, reach: float
) -> tuple[FloatArray, Mask]:
    """Where each row is steepest near a column [px from the middle], and whether it is an edge."""
    n, m = slope.shape
    first = np.round(near - reach).astype(int) + m // 2
    index = np.clip(first[:, None] + np.arange(2 * int(reach) + 2), 1, m - 2)
    rows = np.arange(n)
    column = index[rows, np.take_along_axis(slope, index, 1).argmax(axis=1)]
    before, top, after = (slope[rows, column + step] for step in (-1, 0, 1))
    bend = np.minimum(before - 2.0 * top + after, -1e-6)  # the top of a parabola
    exact = column - m // 2 + np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    return exact, (top > EDGE) & strip.lit[rows, column]


def _robust(X: FloatArray, y: FloatArray, good: Mask) -> tuple[FloatArray, float, Mask]:
    """Fit (2,), scatter of the rows [px] and the rows that fit, by Huber's weights."""
    weight = good.astype(float)
    for _ in range(6):
        fit = np.linalg.lstsq(X * weight[:, None], y * weight, rcond=None)[0]
        off = np.abs(y - X @ fit)
        scatter = 1.4826 * float(np.median(off[good])) + BLUR
        weight = good * np.minimum(1.0, 1.5 * scatter / np.maximum(off, 1e-9))
    kept = good & (off < 3.0 * scatter)
    if kept.sum() < LEAST_ROWS or scatter > STRAIGHT:
        raise NotSeen("the shaft's edges are not straight")
    return np.asarray(fit), scatter, kept
