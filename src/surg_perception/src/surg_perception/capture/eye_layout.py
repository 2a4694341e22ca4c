"""From one grabbed picture to the pictures of the eyes.

Pictures are (height, width, 3) uint8 arrays in RGB.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from surg_perception.capture.picture_source import Image

LAYOUTS = ("two", "sbs", "sbs_half", "top_bottom", "rows", "mono")
"""``two``: a device, or a file, for each eye. ``sbs``: side by side. ``sbs_half``: the same, each
eye squeezed to half its width. ``top_bottom``: the left eye above. ``rows``: even rows are the left
eye's. ``mono``: one eye."""
FLIPS = ("none", "horizontal", "vertical", "rotate_180")
SHARED = ("sbs", "sbs_half", "top_bottom", "rows")
"""Layouts with both eyes in one picture."""
_FLIP_CODES = {"horizontal": 1, "vertical": 0, "rotate_180": -1}


class LayoutError(ValueError):
    """A picture that the layout cannot divide."""


def eyes_of(layout: str) -> tuple[str, ...]:
    """Names of the eyes of a layout."""
    return ("left",) if layout == "mono" else ("left", "right")


def split(picture: Image, layout: str, swap: bool = False, flip: str = "none") -> tuple[Image, ...]:
    """The pictures of the eyes, left first.

    Args:
        picture: As grabbed. With the layouts ``two`` and ``mono`` it is one eye.
        layout: One of ``LAYOUTS``.
        swap: The left eye comes where the layout has the right one.
        flip: One of ``FLIPS``, applied to each eye.

    Raises:
        LayoutError: The size of the picture is odd where it must be even.
    """
    if layout not in SHARED:
        return (turned(picture, flip),)
    height, width = picture.shape[:2]
    across = layout in ("sbs", "sbs_half")
    if (width if across else height) % 2:
        raise LayoutError(
            f"a picture of {width} x {height} has an odd {'width' if across else 'height'}; "
            f"layout {layout} needs an even one"
        )
    if across:
        halves = [picture[:, : width // 2], picture[:, width // 2 :]]
    elif layout == "top_bottom":
        halves = [picture[: height // 2], picture[height // 2 :]]
    else:
        halves = [picture[0::2], picture[1::2]]
    if layout in ("sbs_half", "rows"):  # each eye has half its width or rows
        halves = [_resized(half, width, height) for half in halves]
    left, right = (turned(half, flip) for half in halves)
    return (right, left) if swap else (left, right)


def turned(picture: Image, flip: str) -> Image:
    """The picture, mirrored or turned."""
    if flip == "none":
        return picture
    return _image(cv2.flip(np.ascontiguousarray(picture), _FLIP_CODES[flip]))


def fitted(picture: Image, most: tuple[int, int]) -> Image:
    """The picture at most as large as ``most`` (width, height) with its aspect kept; contiguous."""
    height, width = picture.shape[:2]
    size = fitted_size((width, height), most)
    if size == (width, height):
        return np.ascontiguousarray(picture)
    return _resized(picture, *size)


def fitted_size(size: tuple[int, int], most: tuple[int, int]) -> tuple[int, int]:
    """The size of a picture after `fitted`: even numbers where it shrinks."""
    scale = min(most[0] / size[0], most[1] / size[1])
    if scale >= 1.0:
        return size
    width, height = (max(2, 2 * round(0.5 * scale * edge)) for edge in size)
    return width, height


def _resized(picture: Image, width: int, height: int) -> Image:
    shrinks = width * height < picture.shape[0] * picture.shape[1]
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return _image(cv2.resize(picture, (width, height), interpolation=how))


def _image(array: Any) -> Image:
    return np.asarray(array, np.uint8)
