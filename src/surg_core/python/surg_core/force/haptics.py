"""Force feedback to a hand: faded, limited, and passive. Values in, values out.

A measured force passes, in this order: a limit of its size, a limit of its rate, a gate that fades
to zero when anything is silent or not allowed, and a passivity controller for each axis, which has
the last word.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from surg_core.force.passivity import PassivityChannel
from surg_core.transforms import FloatArray


@dataclass(frozen=True)
class HapticLimits:
    """What a hand may feel.

    Attributes:
        scale: Force on the hand over force at the tip.
        max_force: Largest force on the hand [N].
        max_rate: Largest growth or turn of that force [N/s].
        silent_after: Age of the newest measurement at which it counts as silent [s].
        fade_out, fade_in: Time from all to nothing, and back [s].
        damping: Largest damping of the passivity controller [N s/m].

    Raises:
        ValueError: A member is out of range; names it. Silence and fading must end within 50 ms.
    """

    scale: float = 1.0
    max_force: float = 5.0
    max_rate: float = 200.0
    silent_after: float = 0.020
    fade_out: float = 0.025
    fade_in: float = 0.5
    damping: float = 30.0

    def __post_init__(self) -> None:
        """Check the members."""
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"haptics: {name} is {value!r}; allowed: a number above 0")
        if self.silent_after + self.fade_out > 0.050:
            raise ValueError(
                f"haptics: silent_after + fade_out is {self.silent_after + self.fade_out:g} s; "
                "allowed: up to 0.05"
            )


class HapticFeedback:
    """The force on one hand.

    It begins faded out. Whatever stops it, it comes back by itself only in ``fade_in``.
    """

    def __init__(self, limits: HapticLimits) -> None:
        self._limits = limits
        self.reset()

    def reset(self) -> None:
        """Forget everything: no force, no energy."""
        self._axes = [
            PassivityChannel(self._limits.damping, self._limits.max_force) for _ in range(3)
        ]
        self._smooth = np.zeros(3)
        self.gate = 0.0
        """Share of the force that is let through, 0 to 1."""

    @property
    def energy(self) -> FloatArray:
        """Energy that the hand has put into each axis [J], (3,)."""
        return np.array([axis.energy for axis in self._axes])

    def step(
        self, force: FloatArray, age: float, position: FloatArray, allowed: bool, dt: float
    ) -> FloatArray:
        """The force on the hand until the next step [N], (3,), in the frame of the inputs.

        Args:
            force: (3,) newest measured force of the world on the tip [N].
            age: Of that measurement [s].
            position: (3,) of the hand [m]. One that is not finite gives no force at all.
            allowed: Switched on, engaged and not paused.
            dt: Time since the last step [s].
        """
        limits = self._limits
        if not (np.isfinite(position).all() and dt > 0.0):
            self.reset()
            return np.zeros(3)
        known = bool(np.isfinite(force).all()) and 0.0 <= age <= limits.silent_after
        if known:
            wanted = limits.scale * force
            size = float(np.linalg.norm(wanted))
            wanted = wanted * min(1.0, limits.max_force / max(size, 1e-12))
            change = wanted - self._smooth
            most = limits.max_rate * dt
            self._smooth = self._smooth + change * min(
                1.0, most / max(float(np.linalg.norm(change)), 1e-12)
            )
        step = dt / limits.fade_in if known and allowed else -dt / limits.fade_out
        self.gate = min(1.0, max(0.0, self.gate + step))
        if self.gate == 0.0:
            self._smooth = np.zeros(3)
            for axis, x in zip(self._axes, position, strict=True):
                axis.rest(float(x))
            return np.zeros(3)
        faded = self.gate * self._smooth
        return np.array(
            [
                axis.step(float(f), float(x), dt)
                for axis, f, x in zip(self._axes, faded, position, strict=True)
            ]
        )
