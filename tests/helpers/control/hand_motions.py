"""Synthetic motions of a hand, by seed.

Two families: strokes between targets, as in suturing, and band-limited wandering. Both tremble at
8 to 12 Hz. Speeds and accelerations are those of recorded knot tying: 15 to 25 mm/s rms, peaks to
0.12 m/s and 1.5 m/s^2 per axis.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Hand = Callable[[Array], Array]
"""Position (n, 3) [m] at times (n,) [s] that increase."""

TREMOR = 45e-6
"""Of an axis, rms [m]."""


def strokes(seed: int, seconds: float) -> Hand:
    """Minimum-jerk strokes that overlap or pause, on a slow drift."""
    rng = np.random.default_rng(seed)
    at = np.zeros(3)
    t = 0.0
    parts: list[tuple[float, float, Array]] = []
    while t < seconds:
        time = max(float(np.exp(rng.normal(np.log(0.42), 0.35))), 0.12)
        size = min(
            float(np.exp(rng.normal(np.log(0.007), 0.6))), 0.045, 0.107 * time, 0.31 * time**2
        )
        heading = rng.normal(size=3) - at / 0.02
        step = size * heading / np.linalg.norm(heading)
        parts.append((t, time, step))
        at = at + step
        rest = rng.uniform(0.3, 1.5) if rng.random() < 0.08 else 0.0
        t += time * rng.uniform(0.45, 1.3) + rest
    drift = [
        (rng.uniform(0.05, 0.6), rng.uniform(0, 6.28, 3), rng.normal(size=3)) for _ in range(6)
    ]
    tremor = _tremor(rng)

    def motion(t: Array) -> Array:
        p = tremor(t)
        for begin, time, step in parts:
            first, last = np.searchsorted(t, [begin, begin + time])
            s = (t[first:last] - begin) / time
            p[first:last] += (s**3 * (10 - 15 * s + 6 * s * s))[:, None] * step
            p[last:] += step
        for hertz, phase, size in drift:
            p += 0.004 * size * np.sin(2 * np.pi * hertz * t[:, None] + phase)
        return p

    return motion


def wandering(seed: int, seconds: float) -> Hand:
    """Gaussian motion whose velocity fades above 1.2 Hz."""
    rng = np.random.default_rng(seed)
    hertz = rng.uniform(0.05, 6.0, size=120)
    speed = 1 / (1 + (hertz / 1.2) ** 2)
    speed *= 0.018 / np.sqrt(np.sum(speed**2) / 2)
    size = (speed / (2 * np.pi * hertz))[:, None] * np.ones(3)
    phase = rng.uniform(0, 2 * np.pi, size=(120, 3))
    tremor = _tremor(rng)

    def motion(t: Array) -> Array:
        p = tremor(t)
        for f, a, angle in zip(hertz, size, phase, strict=True):
            p += a * np.sin(2 * np.pi * f * t[:, None] + angle)
        return p

    return motion


def _tremor(rng: np.random.Generator) -> Hand:
    hertz, phase = rng.uniform(8, 12, size=3), rng.uniform(0, 2 * np.pi, size=3)

    def motion(t: Array) -> Array:
        return np.sqrt(2) * TREMOR * np.sin(2 * np.pi * hertz * t[:, None] + phase)

    return motion
