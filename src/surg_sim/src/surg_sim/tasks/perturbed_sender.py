"""A scripted expert whose path is perturbed, so that demonstrations show recovery.

Demonstrations of an unperturbed script contain no states beside its path; a policy trained on them
cannot return to it. This expert adds a slow random offset to the tip, which fades near every goal,
so that actions at a goal stay precise. The recording contains the commands as sent. On average an
offset decays, and that is what the policy learns.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from surg_core.contract import STEP
from surg_sim.tasks.scripted_arm import ArmExpert
from surg_sim.tasks.scripted_sender import Action, Expert, Observation

TIME = 0.4
"""Time constant of each of the two low-pass filters of the offset [s]."""
NEAR = 0.015
"""Distance from a goal within which the offset fades [m]."""


class PerturbedExpert(Expert):
    """Perturbs the path of another expert.

    The offset has this seed and this standard deviation per axis [m].
    """

    def __init__(self, expert: ArmExpert, seed: int, spread: float) -> None:
        self.arms = expert.arms
        self._expert = expert
        self._rng = np.random.default_rng([seed, 7])
        self._keep = math.exp(-STEP / TIME)
        # Gain of white noise before two equal low-pass filters that gives the output `spread`.
        a = self._keep
        self._gain = spread * math.sqrt((1 - a * a) ** 3 / ((1 - a) ** 4 * (1 + a * a)))
        self._slow, self._offset = np.zeros(3), np.zeros(3)
        self._begun = False

    def act(self, observation: Observation) -> Action:
        """See :class:`Expert`."""
        action = self._expert.act(observation)
        self.reason = self._expert.reason
        a = self._keep
        self._slow = a * self._slow + (1 - a) * self._gain * self._rng.standard_normal(3)
        self._offset = a * self._offset + (1 - a) * self._slow
        arms = dict(action.arms)
        if not self._begun and any(commands.servo_cp for commands in arms.values()):
            # A first pose far from the arm would be refused, and all that follow it.
            self._begun, self._slow, self._offset = True, np.zeros(3), np.zeros(3)
        for name, commands in arms.items():
            pose = commands.servo_cp
            if pose is not None:
                path = self._expert.path
                left = float(np.linalg.norm(path.goal - path.at))
                p = pose.p + min(left / NEAR, 1.0) * self._offset
                arms[name] = replace(commands, servo_cp=replace(pose, p=p))
        return Action(arms=arms, assistant=action.assistant)
