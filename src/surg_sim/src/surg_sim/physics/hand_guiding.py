"""A hand that leads a simulated arm home, as somebody who stands beside a real one would.

After FAULT(rcm_error) the shaft is off its trocar, and a controller must not enable until somebody
has put that right. A real arm is pushed by hand; this is the simulated one's. Pure.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surg_sim.physics.sim_arm import ArmCommand

GAIN = 2.0
"""Of the way that is left [1/s]."""
SPEED = 0.2
"""Of the fastest joint [rad/s]."""
THERE = 5e-4
"""From home [rad]: half a millimetre at the trocar."""
STILL = 1e-3
"""What a controller may still command: more means that it moves the arm itself [rad/s, m/s]."""


class ByHand:
    """One way home.

    Args:
        home: (n,) joint positions to lead to [rad].
    """

    def __init__(self, home: NDArray[np.float64]) -> None:
        self._home = np.asarray(home, dtype=float)

    def lead(self, q: NDArray[np.float64], command: ArmCommand) -> ArmCommand | None:
        """Where the hand pushes in this tick.

        Args:
            q: (n,) where the arm is [rad].
            command: What its controller sent.

        Returns:
            What the arm does instead; None: the hand lets go, as the arm is home, or its controller
            moves it.
        """
        for sent in (command.velocity, command.twist):
            if sent is not None and not np.abs(sent).max() <= STILL:
                return None
        left = self._home - q
        if np.abs(left).max() < THERE:
            return None
        velocity = GAIN * left
        return ArmCommand(velocity * min(1.0, SPEED / np.abs(velocity).max()), None, command.jaw)
