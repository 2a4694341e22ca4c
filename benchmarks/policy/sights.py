"""What happens to the pictures that a policy gets: proof that it looks, and how robust it is.

Each condition is drawn from the episode's seed, so a roll-out repeats.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import ndimage

from surg_sim.appearance.domain_randomization import DomainRandomization

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


@dataclass(frozen=True)
class Condition:
    """One row of the table."""

    name: str
    eye: Callable[[np.random.Generator], Filter] | None = as_taken
    """None: the pictures of another episode."""
    view: str = "left"
    """Of the endoscope's two eyes; the policy takes it for the left one."""
    setting: str = "phantom"
    aside: float = 0.0
    """The camera is moved so far along the picture's rows [m]."""
    turn: float = 0.0
    """The camera is turned up so far [deg]."""
    targets: tuple[int, int] | None = None
    """First and last node that the assistant may point at; None: those of training."""
    randomization: DomainRandomization | None = None
    """Ranges of the light, tissue, lens and pose of each episode; None: as built."""
    blind: bool = field(default=False)
    """What is shown says nothing about this episode."""


_STILL = replace(DomainRandomization(), camera_shift_mm=(0.0, 0.0), camera_turn_deg=(0.0, 0.0))

CONDITIONS = (
    Condition("as trained"),
    Condition("first picture frozen", frozen, blind=True),
    Condition("black", black, blind=True),
    Condition("another episode's pictures", None, blind=True),
    Condition("the right eye's pictures", view="right"),
    Condition("light 60 %", light(0.6)),
    Condition("light 30 %", light(0.3)),
    Condition("blur, 4 px", blur(4.0)),
    Condition("smoke, up to 50 %", smoke(0.5)),
    Condition("a smudge on the lens", smudge),
    Condition("a third instrument in front", instrument),
    Condition("camera moved 10 mm", aside=0.010),
    Condition("camera moved 20 mm", aside=0.020),
    Condition("camera turned 10°", turn=10.0),
    Condition("drawn appearance, camera where it was", randomization=_STILL),
    Condition(
        "drawn appearance, camera up to 4 mm and 2° off", randomization=DomainRandomization()
    ),
    Condition("nodes 14 to 16", targets=(14, 16)),
    Condition("nodes 23 to 25", targets=(23, 25)),
    Condition("setting ex_vivo", setting="ex_vivo"),
    Condition("setting in_vivo", setting="in_vivo"),
)
