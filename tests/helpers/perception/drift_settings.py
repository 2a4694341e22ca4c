"""Three settings of the drift bench: how well a shaft finder sees shafts in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Setting:
    """What is wrong with sightings, and with the instrument.

    In the simulator's pictures with the grain, blur, light and smoke of each, the finder's offsets
    scatter by 0.07 px, alike for 0.3 s and half alike in both eyes; it misses 44, 52 and 54 of 100
    shafts, and takes something else for 1 to 3 of 100, which their width mostly shows. Real
    pictures are worse than drawn ones: here noise and bias are two, three and four times as large.

    Attributes:
        noise: White, of each offset [px].
        bias: That changes smoothly with the place in the picture: shade, blood, a bent shaft [px].
        hidden: Share of the time in which a shaft is hidden.
        wrong: Share of the time in which something else is taken for it.
        bend: Of the shaft's tip by the breathing wall, half of peak to peak [m].
        tip: How far the true tip is beside the stated one [m], as in `SETTINGS` of `surg_sim`.
        axis: How far the true shaft is turned about it [rad], the same.
    """

    noise: float
    bias: float
    hidden: float
    wrong: float
    bend: float
    tip: float
    axis: float


SEEN_IN = {
    "phantom": Setting(0.15, 0.15, 0.45, 0.01, 0.0, 0.0001, np.radians(0.07)),
    "ex vivo": Setting(0.2, 0.2, 0.5, 0.015, 0.0, 0.0002, np.radians(0.14)),
    "in vivo": Setting(0.3, 0.3, 0.55, 0.02, 0.0002, 0.0003, np.radians(0.21)),
}
"""Bend: 2 mm of breathing against 800 N/m push a steel tube of 8 mm by 1.5 N, 0.15 m behind its
flange; the tip, 0.1 m farther, goes 0.2 mm."""
BREATH = 4.0
"""[s] Of one breath."""
PATCH = 60.0
"""[px] Over which a bias changes."""


class SmoothNoise:
    """Of unit variance, a function of place or time (k,): a sum of waves.

    Args:
        rng: Draws it.
        k: Length of its argument.
        highest: Largest angular frequency along an axis.
    """

    def __init__(self, rng: np.random.Generator, k: int, highest: float) -> None:
        self._w = rng.uniform(-highest, highest, (24, k))
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 24)

    def __call__(self, at: Array | float) -> float:
        """Its value at one place."""
        return float(np.cos(self._w @ np.atleast_1d(at) + self._phase).sum() / np.sqrt(12.0))


class Flaws:
    """What a finder adds to the true offsets of both eyes in one setting.

    Args:
        setting: The setting.
        rng: Draws everything.
    """

    def __init__(self, setting: Setting, rng: np.random.Generator) -> None:
        self.setting, self._rng = setting, rng
        self._biases = [SmoothNoise(rng, 2, 1.0 / PATCH) for _ in range(3)]
        self._veils = [SmoothNoise(rng, 1, 2.0) for _ in range(3)]
        self._lures = [SmoothNoise(rng, 1, 6.0) for _ in range(2)]
        self._breath = rng.uniform(0.0, 2.0 * np.pi)
        way, turn = rng.normal(size=(2, 3))
        self.tool = np.r_[
            setting.axis * turn / np.linalg.norm(turn), setting.tip * way / np.linalg.norm(way)
        ]

    def tool_at(self, at: float) -> Array:
        """(6,) how the instrument differs from its file: mounted, and bent by the breath."""
        bend = self.setting.bend * np.sin(2.0 * np.pi * at / BREATH + self._breath)
        return self.tool + np.r_[0.0, -bend / 0.25, 0.0, bend, 0.0, 0.0]

    def hidden(self, at: float, eye: int) -> bool:
        """Whether smoke or tissue hides the shaft from an eye."""
        veil = 0.8 * self._veils[2](at) + 0.6 * self._veils[eye](at)
        return veil < _quantile(self.setting.hidden)

    def offsets(self, at: float, eye: int, places: Sequence[Array]) -> Array:
        """(n,) of what is seen at places (2,) of the picture beside the true shaft [px]."""
        if self._lures[0](at) < _quantile(self.setting.wrong):
            size = 3.0 * np.exp(1.5 + 0.8 * self._lures[1](at))  # 3 to 60 px
            return np.full(len(places), size if eye or self._rng.integers(2) else -size)
        bias = [0.7 * (self._biases[2](p) + self._biases[eye](p)) for p in places]
        noise = self.setting.noise * self._rng.normal(size=len(places))
        return np.asarray(self.setting.bias * np.array(bias) + noise)


def _quantile(share: float) -> float:
    """Below which a normal number is with this probability."""
    from scipy.stats import norm

    return float(norm.ppf(share))
