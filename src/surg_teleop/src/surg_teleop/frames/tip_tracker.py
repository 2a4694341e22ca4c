"""Finds the instrument's tip in pictures: segmented by its motion, tracked by its appearance.

There is a picture at rest and one to either side of rest along three axes. Pixels that differ from
the picture at rest on *both* sides of an axis show the instrument at rest (three-frame
differencing). This needs no model and no expected position. The end of the instrument inside the
picture is the tip. A patch around it is located in every picture by weighted normalised
cross-correlation, to sub-pixel accuracy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal

from surg_core.arm_view import Array
from surg_teleop.frames.probe_moves import AXES, REST, ProbeMove

Smooth = NDArray[np.float32]
Picture = NDArray[np.uint8]

REACH = 0.18
"""Search radius as a share of the picture's height."""
PATCH = 0.075
"""Radius of the patch as a share of the picture's height."""
NEAR = 6.0
"""[px] Largest change of the disparity."""
FINE = 0.25
"""[px] Step of the search along the disparity."""
LEAST = 80
"""[px] Smallest area of an instrument."""
ALIKE = 0.6
"""Smallest correlation of a match."""
CHANGED = 10.0
"""[grey levels] Smallest change above noise."""


class NotSeen(ValueError):
    """The tip was not found; the message states why and what to do."""


@dataclass(frozen=True)
class Place:
    """Tip in the pictures of one exposure."""

    left: Array  # (2,) x right, y down, in the left picture [px]
    # (2,) position in the left minus position in the right picture [px]; None with one eye
    disparity: Array | None


@dataclass(frozen=True)
class Patch:
    """A piece of a picture with a weight per pixel."""

    look: Smooth  # (h, w, 3) smoothed colours
    weight: Smooth  # (h, w) 1 on the instrument, 0 elsewhere
    corner: NDArray[np.int64]  # (2,) x, y of its first pixel
    tip: Array  # (2,) tip in the picture [px]


def find_places(
    left: Mapping[ProbeMove, Picture], right: Mapping[ProbeMove, Picture] | None = None
) -> dict[ProbeMove, Place]:
    """Find the tip in the pictures of all steps.

    Args:
        left: (h, w, 3) rgb8 by step: ``REST`` and both sides of every axis.
        right: The same of the right eye, exposed at the same times.

    Raises:
        NotSeen: Nothing has moved, or the tip was not found.
    """
    smooth = {step: _smooth(picture) for step, picture in left.items()}
    rest = smooth[REST]
    patch = _tip_patch(rest, smooth)
    reach = round(REACH * rest.shape[0])
    other = None if right is None else {step: _smooth(picture) for step, picture in right.items()}
    across = np.zeros(2) if other is None else _find(patch, other[REST], np.zeros(2), reach)
    places = {}
    for step, picture in smooth.items():
        shift, disparity = np.zeros(2), None
        if step != REST:
            shift = _find(patch, picture, shift, reach, f"after the move {step}")
        if other is not None:
            # The other eye has the same exposure: same light, size and angle.
            there = _moved(patch, picture, shift)
            # The direction of the disparity is fixed, so search along it only: otherwise the patch
            # would slide along a plain shaft.
            disparity = -_find(there, other[step], across, NEAR, on_line=True)
        places[step] = Place(patch.tip + shift, disparity)
    return places


def _smooth(picture: Picture) -> Smooth:
    """Reduce noise, and make correlation peaks parabolic."""
    colours = picture.astype(np.float32)
    return np.asarray(ndimage.gaussian_filter(colours, (1.0, 1.0, 0.0), truncate=2.0))


def _tip_patch(rest: Smooth, all_: Mapping[ProbeMove, Smooth]) -> Patch:
    """Patch around the tip at rest."""
    shape = rest.shape[:2]
    instrument = np.zeros(shape, dtype=bool)
    for axis in AXES:
        plus, minus = (_changed(rest, all_[ProbeMove(axis, sign)]) for sign in (1, -1))
        instrument |= plus & minus
    instrument = ndimage.binary_opening(instrument, iterations=1)
    instrument = ndimage.binary_closing(instrument, iterations=4)
    parts, count = ndimage.label(ndimage.binary_dilation(instrument, iterations=3))
    sizes = ndimage.sum_labels(instrument, parts, range(1, count + 1)) if count else []
    if not count or max(sizes) < LEAST:
        raise NotSeen(
            "nothing has moved in the picture; check that the picture is live and the lens clean, "
            "move the tip to the middle of the picture and try again"
        )
    instrument &= parts == 1 + int(np.argmax(sizes))
    tip = _inner_end(instrument, _lit(list(all_.values())))
    radius = PATCH * shape[0]
    y, x = np.nonzero(instrument)
    near = np.hypot(x - tip[0], y - tip[1]) < radius
    x, y = x[near], y[near]
    corner = np.array([x.min(), y.min()])
    size = np.array([x.max(), y.max()]) - corner + 1
    weight = np.zeros((size[1], size[0]), dtype=np.float32)
    weight[y - corner[1], x - corner[0]] = 1.0
    look = rest[corner[1] : corner[1] + size[1], corner[0] : corner[0] + size[0]]
    return Patch(look, weight, corner, tip)


def _changed(a: Smooth, b: Smooth) -> NDArray[np.bool_]:
    """Pixels that differ by more than noise, whose level is the median of all pixels."""
    difference = np.abs(a - b).max(axis=2)
    return np.asarray(difference > max(CHANGED, 8.0 * float(np.median(difference))))


def _lit(pictures: Sequence[Smooth]) -> NDArray[np.bool_]:
    """Illuminated part of the picture; an endoscope's is round."""
    return np.asarray(ndimage.binary_fill_holes(np.max(pictures, axis=(0, 3)) > 12.0))


def _inner_end(instrument: NDArray[np.bool_], lit: NDArray[np.bool_]) -> Array:
    """The end of an elongated region that is farther from the edge of the picture, (2,) x, y."""
    y, x = np.nonzero(instrument)
    points = np.column_stack([x, y]).astype(np.float64)
    middle = points.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((points - middle).T))
    along = (points - middle) @ axes[:, 1]
    padded = np.pad(lit, 1)  # the border of the picture counts as an edge
    inside = ndimage.distance_transform_edt(padded)[1:-1, 1:-1]
    ends = []
    for end in (along <= np.quantile(along, 0.03), along >= np.quantile(along, 0.97)):
        place = points[end].mean(axis=0)
        ends.append((float(inside[round(place[1]), round(place[0])]), place))
    return np.asarray(max(ends, key=lambda e: e[0])[1])


def _moved(patch: Patch, picture: Smooth, shift: Array) -> Patch:
    """The patch in another picture of the same eye, shifted by whole pixels."""
    whole = np.round(shift).astype(np.int64)
    corner = patch.corner + whole
    height, width = patch.weight.shape
    first = np.maximum(corner, 0)
    size = np.array([width, height])
    last = np.minimum(corner + size, [picture.shape[1], picture.shape[0]])
    cut = (
        slice(first[1] - corner[1], last[1] - corner[1]),
        slice(first[0] - corner[0], last[0] - corner[0]),
    )
    look = picture[first[1] : last[1], first[0] : last[0]]
    return Patch(look, patch.weight[cut], first, patch.tip + shift)


def _find(
    patch: Patch,
    picture: Smooth,
    guess: Array,
    reach: float,
    where: str = "in the right picture",
    on_line: bool = False,
) -> Array:
    """Shift (2,) [px] of a patch in a picture, near a guess."""
    height, width = patch.weight.shape
    span = int(np.ceil(reach))
    low = patch.corner + np.round(guess).astype(np.int64) - span
    high = low + np.array([width, height]) + 2 * span
    limit = np.array([picture.shape[1], picture.shape[0]])
    first, last = np.maximum(low, 0), np.minimum(high, limit)
    if np.any(last - first < [width, height]):
        raise NotSeen(f"the tip leaves the picture {where}; move it to the middle and try again")
    window = picture[first[1] : last[1], first[0] : last[0]]
    score = _correlate(patch, window)
    if on_line and np.hypot(*guess) > 1.0:
        shift, best = _on_line(score, guess, guess - (first - patch.corner), reach)
    else:
        row, column = divmod(int(np.argmax(score)), score.shape[1])
        best = float(score[row, column])
        shift = first - patch.corner + np.array([column, row]) + _peak_offset(score, row, column)
    if best < ALIKE:
        raise NotSeen(
            f"the tip was not recognised {where} (correlation {best:.2f}, needed {ALIKE}); check "
            "that nothing hides it and that the picture does not stutter"
        )
    return np.asarray(shift, dtype=np.float64)


def _on_line(score: Array, guess: Array, at: Array, reach: float) -> tuple[Array, float]:
    """Best shift (2,) [px] along the guess, which lies at (column, row) of the score."""
    along = guess / np.hypot(*guess)
    t = np.arange(-reach, reach + FINE, FINE)
    columns, rows = at[:, None] + along[:, None] * t
    line = ndimage.map_coordinates(score, [rows, columns], order=3, mode="constant", cval=-1.0)
    best = int(np.argmax(line))
    further = FINE * _peak_offset(line[None], 0, best)[0]
    return guess + (t[best] + further) * along, float(line[best])


def _correlate(patch: Patch, window: Smooth) -> Array:
    """Weighted normalised cross-correlation at every whole shift, (rows, columns), -1 to 1."""
    weight, total = patch.weight, float(patch.weight.sum())
    up, energy, own = np.zeros(1), np.zeros(1), 0.0
    for c in range(3):
        look, seen = patch.look[..., c], window[..., c] - np.float32(128.0)
        template = weight * (look - float((weight * look).sum()) / total)
        up = up + _slide(seen, template)
        energy = energy + np.maximum(_slide(seen**2, weight) - _slide(seen, weight) ** 2 / total, 0)
        own += float((template**2).sum())
    return np.asarray(up / np.sqrt(np.maximum(energy * own, 1e-9 + 1e-6 * own * total)))


def _slide(window: Smooth, weight: Smooth) -> Array:
    return np.asarray(signal.correlate(window, weight, mode="valid", method="fft"))


def _peak_offset(score: Array, row: int, column: int) -> Array:
    """Sub-pixel offset (2,) x, y of a peak, by parabolas through the neighbours."""

    def offset(before: float, here: float, after: float) -> float:
        bend = before - 2.0 * here + after
        return 0.0 if bend >= 0.0 else float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5))

    rows, columns = score.shape
    x = y = 0.0
    if 0 < column < columns - 1:
        x = offset(*score[row, column - 1 : column + 2])
    if 0 < row < rows - 1:
        y = offset(*score[row - 1 : row + 2, column])
    return np.array([x, y])
