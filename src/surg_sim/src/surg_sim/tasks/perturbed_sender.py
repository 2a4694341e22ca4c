"""A scripted sender whose hand is pushed about on the way.

Demonstrations of a script that always goes its own way say nothing about what lies beside it: a
policy that learned from them does not know how to come back. Here a slow random offset is added to
the tip on its way, and fades out towards every goal, so that what is done at a goal is done as well
as without. What is recorded is the command that was sent, push and return; on average over many
pushes an offset only decays, and that is what is learned.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surg_core.arm_view import TipPose
from surg_core.contract import STEP
from surg_sim.tasks.scripted_arm import ArmExpert
from surg_sim.tasks.scripted_sender import Action, Expert, Observation

Array = NDArray[np.float64]

TIME = 0.4
"""Of each of the two low passes that make the offset smooth [s]."""
NEAR = 0.015
"""The offset fades within this distance of a goal [m]."""


class PerturbedExpert(Expert):
    """Plays another sender's part with a less steady hand.

    Args:
        expert: The sender.
        seed: Of the offset.
        spread: Standard deviation of the offset, per axis [m].
    """

    def __init__(self, expert: ArmExpert, seed: int, spread: float) -> None:
        self.arms = expert.arms
        self._expert = expert
        self._rng = np.random.default_rng([seed, 7])
        self._keep = math.exp(-STEP / TIME)
        # Variance of white noise behind two equal low passes, so that `spread` is what comes out.
        a = self._keep
        self._gain = spread * math.sqrt((1 - a * a) ** 3 / ((1 - a) ** 4 * (1 + a * a)))
        self._slow, self._offset = np.zeros(3), np.zeros(3)

    def act(self, observation: Observation) -> Action:
        """See :class:`Expert`."""
        action = self._expert.act(observation)
        self.reason = self._expert.reason
        a = self._keep
        self._slow = a * self._slow + (1 - a) * self._gain * self._rng.standard_normal(3)
        self._offset = a * self._offset + (1 - a) * self._slow
        arms = dict(action.arms)
        for name, commands in arms.items():
            pose = commands.servo_cp
            if pose is not None:
                path = self._expert.path
                left = float(np.linalg.norm(path.goal - path.at))
                p = pose.p + min(left / NEAR, 1.0) * self._offset
                arms[name] = replace(commands, servo_cp=TipPose(p, pose.roll))
        return Action(arms=arms, assistant=action.assistant)
