"""Two controllers that keep clear of each other, and what they drive, in one process."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import surg_core
from helpers.control.lagging_arm import LagPlant
from surg_core import Motion, MotionCommand, StateCommand

Array = NDArray[np.float64]


class GuardedArm(LagPlant):
    """One arm with its controller.

    Args:
        arm: Of a cell; its robot's own limits are used, not the cell's tighter ones.
        clearance: Its setup; None: no guard.
        q: Joint positions at the start, (n,) [rad]; None: home.
    """

    def __init__(
        self,
        arm: surg_core.Arm,
        clearance: surg_core.ClearanceSetup | None,
        q: Array | None = None,
    ) -> None:
        super().__init__(arm.robot.home if q is None else q)
        self.arm = arm
        self.controller = surg_core.Controller(
            arm.chain, arm.robot, arm.robot.limits, arm.instrument, arm.tool, clearance=clearance
        )
        assert self.controller.set_rcm(arm.trocar.p_BRcm) == surg_core.Reason.NONE

    def start(self, others: list[surg_core.OtherArm]) -> None:
        """Home and enable."""
        self.out = self.controller.step(self.q, self.qd, others=others)
        for word in (StateCommand.HOME, StateCommand.ENABLE):
            assert self.controller.request(word) == surg_core.Reason.NONE

    def state(self) -> surg_core.OtherArm:
        """What another arm hears of this one."""
        return surg_core.OtherArm(self.q, self.qd)

    def step(self, commands: list[MotionCommand], others: list[surg_core.OtherArm]) -> None:
        """One cycle of the controller."""
        self.out = self.controller.step(self.q, self.qd, commands, others=others)


def started(
    arms: list[surg_core.Arm], setups: list[surg_core.ClearanceSetup | None]
) -> list[GuardedArm]:
    """Two arms, homed and enabled."""
    made = [GuardedArm(arm, setup) for arm, setup in zip(arms, setups, strict=True)]
    for own, other in (made, made[::-1]):
        own.start([other.state()] if setups[0] is not None else [])
    return made


def tick(pair: list[GuardedArm], commands: list[list[MotionCommand]], guarded: bool = True) -> None:
    """One cycle of both arms from the same measured states, as in lock-step."""
    states = [arm.state() for arm in pair]
    for i, arm in enumerate(pair):
        arm.step(commands[i], [states[1 - i]] if guarded else [])
    for arm in pair:
        arm.obey(arm.out.qd_command)


class RandomMotion:
    """Moves to random places, velocities, streams and pauses, one after the other.

    Attributes:
        motions: Commanded so far.
    """

    def __init__(self, arm: GuardedArm, rng: np.random.Generator) -> None:
        self._arm, self._rng = arm, rng
        self._home = np.array([0.0, 0.0, float(arm.out.virtual_q[2])])
        self._until, self._kind, self.motions = 0, 0, 0
        self._target, self._from = self._home, self._home

    def commands(self, k: int) -> list[MotionCommand]:
        """For tick k."""
        rng = self._rng
        begins = k >= self._until
        if begins:
            self._kind = int(rng.choice(3, p=[0.4, 0.4, 0.2]))
            self._until = k + int(rng.integers(20, 150))
            self.motions += 1
            spread = np.array([0.07, 0.07, 0.05]) * rng.uniform(0.2, 1.0)
            self._target = self._home + rng.uniform(-1.0, 1.0, 3) * spread
            self._target[2] = max(self._target[2], 0.04)
        if self._kind == 0:
            if not begins:
                return []
            turn = rng.uniform(-1.0, 1.0)
            rotation = [0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)]
            return [MotionCommand(Motion.MOVE_CP, 1, p=self._target, rotation=rotation)]
        if self._kind == 1:
            if begins:
                self._from = rng.uniform(-0.2, 0.2, 3)
            return [MotionCommand(Motion.SERVO_CV, 1, p=self._from, roll_rate=0.0)]
        X_BR = np.asarray(self._arm.controller.X_BR)
        here = X_BR[:3, :3].T @ (np.asarray(self._arm.out.p_set) - X_BR[:3, 3])
        towards = self._target - here
        far = float(np.linalg.norm(towards))
        p = here + towards * min(1.0, 4e-4 / max(far, 1e-9))
        roll = float(self._arm.out.roll_set)
        rotation = [0.0, 0.0, np.sin(roll / 2), np.cos(roll / 2)]
        return [MotionCommand(Motion.SERVO_CP, 1, p=p, rotation=rotation)]
