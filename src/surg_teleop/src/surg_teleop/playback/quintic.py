"""Quintic polynomials between two states of several axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core.arm_view import Array


@dataclass(frozen=True)
class Quintic:
    """Quintic between two states (position, velocity, acceleration) of any number of axes.

    Attributes:
        coefficients: (6, axes), lowest power first, in time since its start.
    """

    coefficients: Array

    @staticmethod
    def between(
        start: tuple[Array, Array, Array], end: tuple[Array, Array, Array], T: float
    ) -> Quintic:
        """The quintic between the given states, T seconds apart."""
        (x0, v0, a0), (x1, v1, a1) = start, end
        h = x1 - x0 - v0 * T - a0 * T * T / 2.0
        dv, da = v1 - v0 - a0 * T, a1 - a0
        return Quintic(
            np.stack(
                (
                    x0,
                    v0,
                    a0 / 2.0,
                    10.0 * h / T**3 - 4.0 * dv / T**2 + da / (2.0 * T),
                    -15.0 * h / T**4 + 7.0 * dv / T**3 - da / T**2,
                    6.0 * h / T**5 - 3.0 * dv / T**4 + da / (2.0 * T**3),
                )
            )
        )

    def at(self, t: Array) -> Array:
        """Positions (n, axes) at times (n,) since its start."""
        powers = np.power.outer(t, np.arange(6))
        positions: Array = powers @ self.coefficients
        return positions


def horner(coefficients: Array, u: float) -> Array:
    """Polynomials (k, axes), lowest power first, at u; fast enough for a control cycle."""
    value: Array = coefficients[-1]
    for row in coefficients[-2::-1]:
        value = value * u + row
    return value
