"""Procedural textures of tissue, skin and cloth: seeded, tileable, no picture files.

Noise is a random-phase field with a power-law spectrum ("fractional Brownian motion"). It repeats
without a seam.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from surg_sim.arrays import Array, Picture

Colour = Sequence[float]


def noise(n: int, roughness: float, rng: np.random.Generator) -> Array:
    """Tileable noise, (n, n), zero mean, unit variance.

    The amplitude spectrum falls as 1/f^roughness; larger is smoother.
    """
    fx = np.fft.fftfreq(n, 1.0)[:, None]
    fy = np.fft.rfftfreq(n, 1.0)[None, :]
    frequency = np.hypot(fx, fy)
    frequency[0, 0] = np.inf
    spectrum = frequency**-roughness * np.exp(2j * np.pi * rng.random(frequency.shape))
    field = np.fft.irfft2(spectrum, s=(n, n))
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float64)


def vessels(
    n: int, trunks: int, width: float, rng: np.random.Generator, wander: float = 0.05
) -> Array:
    """Branching vessels, (n, n) in 0..1: 1 in the middle of a vessel.

    The trunks start with the full radius ``width`` [px], branches taper; ``wander`` is the largest
    turn per pixel of length [rad].
    """
    picture = np.zeros((n, n))
    reach = int(np.ceil(width)) + 2
    window = np.arange(-reach, reach + 1)
    todo = [(*(rng.random(2) * n), rng.random() * 2 * np.pi, width) for _ in range(trunks)]
    while todo:
        x, y, heading, radius = todo.pop()
        turn = 0.0
        length = int(n * (0.25 + 0.45 * rng.random()) * radius / width) + 8
        for step in range(length):
            # Tens of thousands of steps: plain numbers, and no function of numpy that checks much.
            turn = min(max(0.93 * turn + rng.normal(0.0, 0.25 * wander), -wander), wander)
            heading += turn
            x, y = x + math.cos(heading), y + math.sin(heading)
            thin = radius * (1.0 - 0.75 * step / length)
            row, column = math.floor(x), math.floor(y)
            distance = np.hypot((window + (row - x))[:, None], (window + (column - y))[None, :])
            stamp = np.minimum(np.maximum(thin + 0.6 - distance, 0.0), 1.0)
            stamp *= min(1.0, 0.35 + thin / width)
            block = ((window + row) % n)[:, None], ((window + column) % n)[None, :]
            picture[block] = np.maximum(picture[block], stamp)
            if radius > 0.6 and rng.random() < 9.0 / n:
                side = 1.0 if rng.random() < 0.5 else -1.0
                todo.append((x, y, heading + side * (0.5 + 0.6 * rng.random()), thin * 0.62))
    return picture


def _blend(base: Array, colour: Colour, weight: Array) -> Array:
    return base + weight[..., None] * (np.asarray(colour, dtype=np.float64) - base)


@dataclass(frozen=True)
class Recipe:
    """How a texture is made: base colour, patches, vessels, grain."""

    base: Colour  # colour
    # Colour of light patches, weights of soft and grainy noise, largest weight.
    light: tuple[Colour, float, float, float]
    dark: tuple[Colour, float, float, float]  # the same for dark patches
    # Colour, weight, number of trunks and their radius [px], largest turn [rad/px].
    vessels: tuple[tuple[Colour, float, int, float, float], ...] = ()
    soft: float = 1.8  # exponent of the soft noise
    grain: float | None = None  # exponent of the grainy noise; None: there is none
    speckle: float = 0.0  # brightness of the grain added at the end


RECIPES: Mapping[str, Recipe] = {
    # Omentum: ochre lobules with fine red vessels.
    "fat": Recipe(
        base=(214, 158, 84),
        light=((238, 196, 122), 0.5, 0.25, 0.9),
        dark=((176, 106, 52), 0.45, 0.2, 0.8),
        vessels=(((150, 44, 30), 0.62, 9, 2.6, 0.05), ((160, 52, 38), 0.42, 18, 1.2, 0.05)),
        soft=1.7,
        grain=1.05,
    ),
    # Small bowel: moist pink with a few branching vessels across.
    "bowel": Recipe(
        base=(216, 126, 114),
        light=((236, 160, 146), 0.4, 0.12, 0.8),
        dark=((188, 88, 82), 0.4, 0.12, 0.8),
        vessels=(((146, 32, 36), 0.66, 6, 2.2, 0.05), ((160, 46, 46), 0.45, 12, 1.1, 0.05)),
        soft=1.9,
        grain=1.1,
    ),
    # A thin yellowish-pink membrane with fat along branching vessels.
    "mesentery": Recipe(
        base=(222, 164, 118),
        light=((236, 192, 128), 0.5, 0.2, 0.8),
        dark=((196, 110, 88), 0.4, 0.1, 0.7),
        vessels=(((138, 30, 34), 0.7, 12, 2.6, 0.02),),
        grain=1.1,
    ),
    # Inside of the abdominal wall: dull red with a vessel net.
    "peritoneum": Recipe(
        base=(168, 84, 74),
        light=((204, 122, 104), 0.4, 0.0, 0.8),
        dark=((126, 52, 50), 0.4, 0.0, 0.8),
        vessels=(((120, 26, 32), 0.6, 8, 2.4, 0.05),),
    ),
    # Outside of the abdominal wall.
    "skin": Recipe(
        base=(226, 176, 150),
        light=((238, 196, 172), 0.35, 0.0, 0.7),
        dark=((208, 146, 122), 0.35, 0.0, 0.7),
        grain=0.6,
        speckle=2.5,
    ),
    # Surgical drape: teal non-woven with soft creases.
    "cloth": Recipe(
        base=(40, 104, 118),
        light=((62, 132, 146), 0.3, 0.0, 0.6),
        dark=((28, 80, 94), 0.3, 0.0, 0.6),
        soft=1.6,
        grain=0.3,
        speckle=3.0,
    ),
}
"""Recipe by name of the texture."""


def texture(name: str, n: int, rng: np.random.Generator) -> Picture:
    """A texture of ``RECIPES``, (n, n, 3)."""
    recipe = RECIPES[name]
    soft = noise(n, recipe.soft, rng)
    grain = np.zeros((n, n)) if recipe.grain is None else noise(n, recipe.grain, rng)
    picture = np.empty((n, n, 3))
    picture[:] = recipe.base
    for sign, (colour, of_soft, of_grain, most) in ((1.0, recipe.light), (-1.0, recipe.dark)):
        weight = np.clip(sign * (of_soft * soft + of_grain * grain), 0, most)
        picture = _blend(picture, colour, weight)
    for colour, strength, trunks, radius, wander in recipe.vessels:
        picture = _blend(picture, colour, strength * vessels(n, trunks, radius, rng, wander))
    picture = picture + recipe.speckle * grain[..., None]
    return np.clip(picture, 0, 255).astype(np.uint8)
