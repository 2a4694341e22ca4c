"""Hand guiding: leads a simulated arm back to its home posture, as a person would push a real one.

After FAULT(rcm_error) the shaft is off its trocar. A controller must not enable until somebody has
moved the arm back.
"""

from __future__ import annotations

import numpy as np

from surg_sim.arrays import Array
from surg_sim.physics.sim_arm import ArmCommand

GAIN = 2.0
"""Joint velocity per remaining joint distance [1/s]."""
SPEED = 0.2
"""Largest joint speed [rad/s]."""
THERE = 5e-4
"""Largest joint distance that counts as home [rad]: half a millimetre at the trocar."""
STILL = 1e-3
"""A controller that commands more than this moves the arm itself [rad/s, m/s]."""


def guided_home(home: Array, q: Array, command: ArmCommand) -> ArmCommand | None:
    """The command that replaces the controller's in this tick and leads an arm to its home.

    Home and present joint positions (n,) [rad]. None once the arm is home, or its controller moves
    it.
    """
    for commanded in (command.velocity, command.twist):
        if commanded is not None and not np.abs(commanded).max() <= STILL:
            return None
    remaining = np.asarray(home, dtype=float) - q
    if np.abs(remaining).max() < THERE:
        return None
    velocity = GAIN * remaining
    return ArmCommand(velocity * min(1.0, SPEED / np.abs(velocity).max()), None, command.jaw)
