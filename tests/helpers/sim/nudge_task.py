"""A task from outside the tree, for tests of the graph: both arms go a few millimetres and back.

It succeeds when the first arm's tip has gone where the seed says. One seed in five is unlucky and
fails with a reason, and one in five breaks the simulation.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import surg_core
from surg_core.arm_view import ArmCommands, ArmState, TipPose
from surg_core.contract import STEP
from surg_sim.physics.world import World
from surg_sim.tasks import State, Task, Verdict
from surg_sim.tasks.scripted_sender import (
    Action,
    Expert,
    MinimumJerk,
    Observation,
)

DEPTH = 0.12
"""Of the tip at home in the bundled cells [m]."""
LUCKY, UNLUCKY, BREAKING = 36, 0, 35
"""Seeds."""


class Nudge(Task):
    """Move every arm's tip by some millimetres; rest."""

    name = "nudge"
    title = "Nudge"
    time_limit = 4.0
    commanded = ("PSM1", "ECM")

    def bind(self, world: World) -> None:
        """Keep the world."""
        self._world = world

    def reset(self, rng: np.random.Generator) -> None:
        """Draw where to go, and how it ends."""
        super().reset(rng)
        self._offset = rng.uniform(-0.006, 0.006, 3)
        luck = float(rng.random())
        self._unlucky, self._breaking = luck < 0.2, luck > 0.8

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """One, who moves every arm of the cell."""
        return {"expert": Nudger(tuple(cell.arms))}

    def advance(self) -> None:
        """A breaking one breaks after 0.3 s."""
        super().advance()
        if self._breaking and self.time > 0.3:
            self._world.data.qvel[0] = np.nan

    def state(self) -> State:
        """A vector, a number and an array."""
        truth = self._world.truth("PSM1")
        return {
            "offset": self._offset,
            "depth": float((truth.tip - truth.trocar) @ truth.shaft_axis),
            "corners": np.stack([truth.tip, truth.trocar]),
        }

    def verdict(self) -> Verdict:
        """After a second and a half."""
        phase = "rest" if self.time > 1.2 else "go"
        if self.time > 1.5 and self._unlucky:
            return Verdict(done=True, reason="this seed is unlucky", phase=phase)
        gone = abs(self.state()["depth"] - DEPTH - self._offset[2]) < 1e-3
        if self.time > 1.5 and gone:
            return Verdict(done=True, success=True, reward=1.0, phase=phase)
        return self.late(phase) or Verdict(phase=phase)


class Nudger(Expert):
    """Homes and enables every arm, then streams it to where the task's state says."""

    def __init__(self, arms: tuple[str, ...]) -> None:
        self.arms = arms
        self._ways: dict[str, MinimumJerk] = {}

    def act(self, observation: Observation) -> Action:
        """Home, enable, stream."""
        action = Action()
        for name in self.arms:
            arm = observation.arms[name]
            commands = action.arms[name] = ArmCommands()
            if not arm.homed:
                commands.state = "home"
            elif arm.state != ArmState.ENABLED:
                commands.state = "enable"
            else:
                p, offset = np.array([0.0, 0.0, DEPTH]), observation.point("offset")
                if name not in self._ways:
                    self._ways[name] = MinimumJerk(p, 0.05, 0.3)
                    self._ways[name].go(p + offset)
                tip = self._ways[name].advance(STEP)
                roll = 0.1 * float(np.linalg.norm(tip - p)) / 0.006
                commands.servo_cp, commands.jaw = TipPose(tip, roll), 0.3
        return action
