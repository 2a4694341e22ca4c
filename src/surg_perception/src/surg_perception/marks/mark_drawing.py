"""Draws marks into a picture: what a person looks at, never what is recorded."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt

from surg_core.transforms import FloatArray
from surg_perception.marks.mark_projection import PictureMark

COLOURS = {
    "tip": (0, 255, 255),
    "shaft": (80, 255, 80),
    "jaw": (255, 255, 0),
    "trocar": (255, 120, 255),
}
"""rgb of each kind."""
_SHIFT = 4
"""OpenCV counts in sixteenths of a pixel."""


def drawn(picture: npt.NDArray[np.uint8], marks: Iterable[PictureMark]) -> npt.NDArray[np.uint8]:
    """A copy of a picture (h, w, 3), rgb8, with marks: cross, lines, ring, two-sigma ellipse."""
    made = np.ascontiguousarray(picture).copy()
    for mark in marks:
        colour = COLOURS[mark.name]
        known = mark.pixels[np.isfinite(mark.pixels).all(axis=1)]
        if not len(known) or np.abs(known).max() > 4 * max(picture.shape):
            continue
        if len(mark.pixels) > 1:
            line = _sixteenths(known).reshape(-1, 1, 2)
            cv2.polylines(made, [line], False, colour, 1, cv2.LINE_AA, _SHIFT)
            continue
        x, y = _sixteenths(known[0])
        if mark.name == "trocar":
            cv2.circle(made, (x, y), 6 << _SHIFT, colour, 1, cv2.LINE_AA, _SHIFT)
            continue
        arm = 5 << _SHIFT
        for way in ((arm, 0), (0, arm)):
            ends = (x - way[0], y - way[1]), (x + way[0], y + way[1])
            cv2.line(made, *ends, colour, 1, cv2.LINE_AA, _SHIFT)
        _ellipse(made, mark, (x, y), colour)
    return made


def _ellipse(
    picture: npt.NDArray[np.uint8], mark: PictureMark, at: tuple[int, int], colour: tuple[int, ...]
) -> None:
    found = mark.ellipse()
    if found is None or found[0] > max(picture.shape):
        return
    axes = (round(found[0] * 16), round(found[1] * 16))
    angle = float(np.degrees(found[2]))
    cv2.ellipse(picture, at, axes, angle, 0.0, 360.0, colour, 1, cv2.LINE_AA, _SHIFT)


def _sixteenths(pixels: FloatArray) -> npt.NDArray[np.int32]:
    return np.round(pixels * (1 << _SHIFT)).astype(np.int32)
