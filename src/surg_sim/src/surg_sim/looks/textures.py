"""Procedural textures of tissue, skin and cloth: seeded, tileable, no picture files.

Every function returns an (n, n, 3) array of uint8. Noise is a random-phase field with a power-law
spectrum ("fractional Brownian motion"), so it repeats without a seam.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]
Picture = NDArray[np.uint8]
Colour = Sequence[float]


def noise(n: int, roughness: float, rng: np.random.Generator) -> Field:
    """Tileable noise, (n, n), zero mean, unit variance.

    Args:
        n: Side in pixels.
        roughness: Exponent of the amplitude spectrum, 1/f^roughness; larger is smoother.
        rng: Source of the phases.
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
) -> Field:
    """Branching vessels, (n, n) in 0..1: 1 in the middle of a vessel.

    Args:
        n: Side in pixels.
        trunks: Number of vessels that start with the full width.
        width: Radius of a trunk in pixels; branches taper.
        rng: Source of the course.
        wander: Largest turn per pixel of length [rad].
    """
    picture = np.zeros((n, n))
    reach = int(np.ceil(width)) + 2
    window = np.arange(-reach, reach + 1)
    todo = [(rng.random(2) * n, rng.random() * 2 * np.pi, width) for _ in range(trunks)]
    while todo:
        place, heading, radius = todo.pop()
        turn = 0.0
        length = int(n * (0.25 + 0.45 * rng.random()) * radius / width) + 8
        for step in range(length):
            turn = float(np.clip(0.93 * turn + rng.normal(0.0, 0.25 * wander), -wander, wander))
            heading += turn
            place = place + np.array([np.cos(heading), np.sin(heading)])
            thin = radius * (1.0 - 0.75 * step / length)
            cell = np.floor(place).astype(int)
            dx = window + cell[0] - place[0]
            dy = window + cell[1] - place[1]
            distance = np.hypot(dx[:, None], dy[None, :])
            stamp = np.clip(thin + 0.6 - distance, 0.0, 1.0) * min(1.0, 0.35 + thin / width)
            rows, columns = (window + cell[0]) % n, (window + cell[1]) % n
            block = np.ix_(rows, columns)
            picture[block] = np.maximum(picture[block], stamp)
            if radius > 0.6 and rng.random() < 9.0 / n:
                side = 1.0 if rng.random() < 0.5 else -1.0
                todo.append((place, heading + side * (0.5 + 0.6 * rng.random()), thin * 0.62))
    return picture


def _blend(base: Field, colour: Colour, weight: Field) -> Field:
    return base + weight[..., None] * (np.asarray(colour, dtype=np.float64) - base)


def _picture(values: Field) -> Picture:
    return np.clip(values, 0, 255).astype(np.uint8)


def fat(n: int, rng: np.random.Generator) -> Picture:
    """Omentum: ochre lobules with fine red vessels."""
    lobes, grain = noise(n, 1.7, rng), noise(n, 1.05, rng)
    base = np.empty((n, n, 3))
    base[:] = (214, 158, 84)
    base = _blend(base, (238, 196, 122), np.clip(0.5 * lobes + 0.25 * grain, 0, 0.9))
    base = _blend(base, (176, 106, 52), np.clip(-0.45 * lobes - 0.2 * grain, 0, 0.8))
    base = _blend(base, (150, 44, 30), 0.62 * vessels(n, 9, 2.6, rng))
    return _picture(_blend(base, (160, 52, 38), 0.42 * vessels(n, 18, 1.2, rng)))


def bowel(n: int, rng: np.random.Generator) -> Picture:
    """Small bowel: moist pink with a few branching vessels across."""
    soft, grain = noise(n, 1.9, rng), noise(n, 1.1, rng)
    base = np.empty((n, n, 3))
    base[:] = (216, 126, 114)
    base = _blend(base, (236, 160, 146), np.clip(0.4 * soft + 0.12 * grain, 0, 0.8))
    base = _blend(base, (188, 88, 82), np.clip(-0.4 * soft - 0.12 * grain, 0, 0.8))
    base = _blend(base, (146, 32, 36), 0.66 * vessels(n, 6, 2.2, rng))
    return _picture(_blend(base, (160, 46, 46), 0.45 * vessels(n, 12, 1.1, rng)))


def mesentery(n: int, rng: np.random.Generator) -> Picture:
    """Mesentery: a thin yellowish-pink membrane with fat along branching vessels."""
    soft, grain = noise(n, 1.8, rng), noise(n, 1.1, rng)
    tree = vessels(n, 12, 2.6, rng, wander=0.02)
    base = np.empty((n, n, 3))
    base[:] = (222, 164, 118)
    base = _blend(base, (236, 192, 128), np.clip(0.5 * soft + 0.2 * grain, 0, 0.8))
    base = _blend(base, (196, 110, 88), np.clip(-0.4 * soft - 0.1 * grain, 0, 0.7))
    return _picture(_blend(base, (138, 30, 34), 0.7 * tree))


def peritoneum(n: int, rng: np.random.Generator) -> Picture:
    """Inside of the abdominal wall: dull red with a vessel net."""
    soft = noise(n, 1.8, rng)
    base = np.empty((n, n, 3))
    base[:] = (168, 84, 74)
    base = _blend(base, (204, 122, 104), np.clip(0.4 * soft, 0, 0.8))
    base = _blend(base, (126, 52, 50), np.clip(-0.4 * soft, 0, 0.8))
    return _picture(_blend(base, (120, 26, 32), 0.6 * vessels(n, 8, 2.4, rng)))


def skin(n: int, rng: np.random.Generator) -> Picture:
    """Outside of the abdominal wall."""
    soft, grain = noise(n, 1.8, rng), noise(n, 0.6, rng)
    base = np.empty((n, n, 3))
    base[:] = (226, 176, 150)
    base = _blend(base, (238, 196, 172), np.clip(0.35 * soft, 0, 0.7))
    base = _blend(base, (208, 146, 122), np.clip(-0.35 * soft, 0, 0.7))
    return _picture(base + 2.5 * grain[..., None])


def cloth(n: int, rng: np.random.Generator) -> Picture:
    """Surgical drape: teal non-woven with soft creases."""
    soft, grain = noise(n, 1.6, rng), noise(n, 0.3, rng)
    base = np.empty((n, n, 3))
    base[:] = (40, 104, 118)
    base = _blend(base, (62, 132, 146), np.clip(0.3 * soft, 0, 0.6))
    base = _blend(base, (28, 80, 94), np.clip(-0.3 * soft, 0, 0.6))
    return _picture(base + 3.0 * grain[..., None])
