"""How a breathing wall bends the shafts that it touches, told from noise.

Each bend is a shift of the instrument in its flange's axes, ``a sin(2 pi f t) + b cos(2 pi f t)``
with one rate f for all. Neighbouring sightings are off alike by it, which as noise would have to
be large; as a bend of its own it is told from a part that moved within a breath or two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surg_core.transforms import FloatArray
from surg_perception.drift.drift_fits import WRONG

BEND = 0.0002
"""[m] One sigma of a bend along each axis: a wall of 800 N/m that breathes by 2 mm bends a steel
tube of 8 mm so far."""
RATES = np.arange(0.15, 0.5, 0.01)
"""[Hz] Of breathing, so fine that a phase holds over all kept sightings."""


class ShaftBreath:
    """Bends of all instruments.

    Args:
        tools: Where the steps of each instrument are among all.
    """

    def __init__(self, tools: Sequence[slice]) -> None:
        self._tools, self.size = list(tools), 6 * len(tools)
        self.rate = 0.0
        """[Hz] The likeliest; 0: that nothing breathes is likelier than all rates together."""

    def bends(self, A: FloatArray, stamps: FloatArray) -> FloatArray:
        """Derivatives (N, m, 6 for each tool) by all bends, of those (N, m, P) by all steps."""
        angle = 2.0 * np.pi * self.rate * stamps[:, None, None]
        waves = [wave * (self.rate > 0.0) for wave in (np.sin(angle), np.cos(angle))]
        shifts = [A[..., tool][..., 3:] for tool in self._tools]
        return np.concatenate([wave * shift for shift in shifts for wave in waves], axis=2)

    def heard(self, A: FloatArray, off: FloatArray, stamps: FloatArray) -> bool:
        """Whether another rate is likelier.

        Args:
            A: (N, 4, P) derivatives by all steps, in sigmas.
            off: (N, 4) residuals that no step explains.
            stamps: (N,) [s].
        """
        weight = 1.0 / (1.0 + np.einsum("nr,nr->n", off, off) / (2.0 * WRONG)) ** 2
        angles = 2.0 * np.pi * RATES[:, None] * stamps
        waves = np.stack([np.sin(angles), np.cos(angles)], axis=1)
        twice = np.einsum("n,han,hbn->habn", weight, waves, waves)
        log = np.zeros(len(RATES))
        for tool in self._tools:
            bend = BEND * A[:, :, tool][:, :, 3:]
            L = np.einsum("habn,nij->haibj", twice, bend.transpose(0, 2, 1) @ bend)
            pull = np.einsum("n,nri,nr->ni", weight, bend, off)
            v = np.einsum("han,ni->hai", waves, pull).reshape(-1, 6)
            S = np.eye(6) + L.reshape(-1, 6, 6)
            log += 0.5 * np.sum(v * np.linalg.solve(S, v[..., None])[..., 0], axis=1)
            log -= 0.5 * np.linalg.slogdet(S)[1]
        breathes = np.logaddexp.reduce(log) > np.log(len(RATES))
        before, self.rate = self.rate, float(RATES[int(np.argmax(log))]) if breathes else 0.0
        return self.rate != before
