"""What happens to the pictures that a policy gets: proof that it looks, and how robust it is.

Each filter is drawn from the episode's seed, so a roll-out repeats.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy import ndimage

Picture = np.ndarray
"""(height, width, 3), uint8."""
Filter = Callable[[Picture], Picture]
"""Gets the picture of every grid time, in order."""


def as_taken(rng: np.random.Generator) -> Filter:
    """Nothing happens."""
    del rng
    return lambda picture: picture


def black(rng: np.random.Generator) -> Filter:
    """The light is off."""
    del rng
    return lambda picture: np.zeros_like(picture)


def frozen(rng: np.random.Generator) -> Filter:
    """The first picture stays."""
    del rng
    kept: list[Picture] = []

    def show(picture: Picture) -> Picture:
        if not kept:
            kept.append(picture.copy())
        return kept[0]

    return show


def light(share: float) -> Callable[[np.random.Generator], Filter]:
    """All pixels have this share of their value."""

    def make(rng: np.random.Generator) -> Filter:
        del rng
        return lambda picture: (picture * share).astype(np.uint8)

    return make


def blur(pixels: float) -> Callable[[np.random.Generator], Filter]:
    """Out of focus: a Gaussian of this standard deviation [px]."""

    def make(rng: np.random.Generator) -> Filter:
        del rng
        return lambda picture: ndimage.gaussian_filter(picture, (pixels, pixels, 0))

    return make


def smoke(share: float) -> Callable[[np.random.Generator], Filter]:
    """A bright veil, uneven over the picture, that hides up to this share of what lies behind."""

    def make(rng: np.random.Generator) -> Filter:
        coarse = rng.random((5, 7))
        made: list[Any] = []

        def show(picture: Picture) -> Picture:
            if not made:
                sides = [a / b for a, b in zip(picture.shape, coarse.shape, strict=False)]
                veil = np.clip(ndimage.zoom(coarse, sides, order=1), 0.0, 1.0)
                made.append((share * veil)[..., None])
            veil = made[0]
            return (picture * (1.0 - veil) + 210.0 * veil).astype(np.uint8)

        return show

    return make


def smudge(rng: np.random.Generator) -> Filter:
    """Something sticks to the lens: an eighth of the height in radius, nearly opaque, blurred."""
    centre = rng.uniform(0.3, 0.7, 2)
    made: list[Any] = []

    def show(picture: Picture) -> Picture:
        height, width = picture.shape[:2]
        if not made:
            row, column = np.mgrid[:height, :width]
            middle = np.array([centre[0] * height, (width - height) / 2 + centre[1] * height])
            away = np.hypot(row - middle[0], column - middle[1]) / height
            made.append(0.85 / (1.0 + np.exp((away - 0.125) / 0.015))[..., None])
        cover = made[0]
        return (picture * (1.0 - cover) + np.array([110.0, 60.0, 50.0]) * cover).astype(np.uint8)

    return show


def instrument(rng: np.random.Generator) -> Filter:
    """A third instrument's shaft lies before the scene: a tenth of the height wide, swaying."""
    angle, reach = rng.uniform(0.0, np.pi), rng.uniform(0.1, 0.3)
    count = 0

    def show(picture: Picture) -> Picture:
        nonlocal count
        height, width = picture.shape[:2]
        row, column = np.mgrid[:height, :width] / height
        shift = 0.08 * np.sin(2 * np.pi * count / 60)
        across = (row - 0.5) * np.cos(angle) - (column - width / height / 2) * np.sin(angle)
        along = (row - 0.5) * np.sin(angle) + (column - width / height / 2) * np.cos(angle)
        count += 1
        inside = (np.abs(across - reach - shift) < 0.05) & (along < 0.25)
        hidden = picture.copy()
        hidden[inside] = (70, 72, 75)
        return hidden

    return show


class Replayed:
    """Pictures of another episode, in their order; the last one stays."""

    def __init__(self, pictures: Sequence[Picture]) -> None:
        self._pictures, self._next = pictures, 0

    def __call__(self, picture: Picture) -> Picture:
        """The next one; the present picture is not looked at."""
        del picture
        shown = self._pictures[min(self._next, len(self._pictures) - 1)]
        self._next += 1
        return shown
