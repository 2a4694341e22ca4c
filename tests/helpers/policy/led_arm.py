"""An ideal arm that is led by the real controller, also as the arm of a bench."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import surg_core
from helpers.policy.policy_bench import ARM, Array, FakeArm, WiredBench, cell
from surg_core import Motion, MotionCommand
from surg_core.contract import GRID, SECOND_NS, STEP_NS, TICK
from surg_policy_bridge.server.policy_arm import Target


class Follower:
    """A controller with an ideal arm, at its own rate."""

    def __init__(self) -> None:
        arm = cell().arms[ARM]
        made = surg_core.Controller(arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool)
        made.set_rcm(arm.trocar.p_BRcm)
        self.q, self.qd = np.array(arm.robot.home), np.zeros(6)
        self.controller = made
        self.out = made.step(self.q, self.qd)
        for word in (surg_core.StateCommand.ENABLE, surg_core.StateCommand.HOME):
            assert made.request(word) == surg_core.Reason.NONE
        self.out = made.step(self.q, self.qd)

    def step(self, target: Target | None) -> Array:
        """One cycle; returns the set-point (3,) in R [m]."""
        commands = []
        if target is not None:
            q = surg_core.tip_quaternion(target.p, target.roll)
            commands = [MotionCommand(Motion.SERVO_CP, 1, p=target.p, rotation=q)]
        self.out = self.controller.step(self.q, self.qd, commands)
        assert not self.out.refused, self.out
        self.qd = np.array(self.out.qd_command)
        self.q = self.q + TICK * self.qd
        return self.in_rcm(self.out.p_set)

    def in_rcm(self, p_B: Array) -> Array:
        """A point (3,) in R [m]."""
        X_BR = np.asarray(self.controller.X_BR)
        return np.asarray(X_BR[:3, :3].T @ (np.asarray(p_B) - X_BR[:3, 3]))


class LedArm(FakeArm):
    """The arm of a bench: every step of a policy takes 25 cycles of the controller.

    Attributes:
        tips: (3,) tip of each cycle in R [m].
    """

    def __init__(self) -> None:
        super().__init__()
        self._follower = Follower()
        self.tips: list[Array] = []
        self._look()

    def set(self, target: Target) -> None:
        """A step of the stream."""
        for tick in range(GRID):
            self._follower.step(target if tick == 0 else None)
            self.tips.append(self._follower.in_rcm(self._follower.out.p_BTip))
        self._look()
        goal = self._follower.in_rcm(self._follower.out.p_goal)
        self.view = replace(self.view, p_BSample=goal, jaw=target.jaw, jaw_set=target.jaw)

    def _look(self) -> None:
        out, place = self._follower.out, self._follower.in_rcm
        self.view = replace(self.view, p_BTip=place(out.p_BTip), p_BSet=place(out.p_set))


class LedBench(WiredBench):
    """A bench behind a socket with that arm, in simulated time: only a step lets time pass."""

    def __init__(self) -> None:
        self.step = 0
        super().__init__()
        self.arm: LedArm = LedArm()

    def _clock(self) -> int:
        return SECOND_NS + self.step * STEP_NS
