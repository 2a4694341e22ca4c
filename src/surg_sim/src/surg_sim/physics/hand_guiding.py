"""Hand guiding: leads a simulated arm back to its home posture, as a person would push a real one.

After FAULT(rcm_error) the shaft is off its trocar. A controller must not enable until somebody has
moved the arm back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surg_sim.physics.sim_arm import ArmCommand

GAIN = 2.0
"""Joint velocity per remaining joint distance [1/s]."""
SPEED = 0.2
"""Largest joint speed [rad/s]."""
THERE = 5e-4
"""Largest joint distance that counts as home [rad]: half a millimetre at the trocar."""
STILL = 1e-3
"""A controller that commands more than this moves the arm itself [rad/s, m/s]."""


class HandGuiding:
    """Guides one arm to its home posture, (n,) [rad]."""

    def __init__(self, home: NDArray[np.float64]) -> None:
        self._home = np.asarray(home, dtype=float)

    def guide(self, q: NDArray[np.float64], command: ArmCommand) -> ArmCommand | None:
        """The command that replaces the controller's in this tick.

        q is the arm's joint positions, (n,) [rad]. None once the arm is home, or its controller
        moves
        it.
        """
        for commanded in (command.velocity, command.twist):
            if commanded is not None and not np.abs(commanded).max() <= STILL:
                return None
        remaining = self._home - q
        if np.abs(remaining).max() < THERE:
            return None
        velocity = GAIN * remaining
        return ArmCommand(velocity * min(1.0, SPEED / np.abs(velocity).max()), None, command.jaw)
