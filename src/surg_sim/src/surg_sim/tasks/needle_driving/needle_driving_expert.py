"""The script of needle driving: look, place the point, drive along the arc, back out, try again.

The tip's place and the roll are the arm's four degrees of freedom, and the needle is rigid in the
jaws. So a point of its arc can be put into the hole with its tangent in the plane of the hole's
axis; how far the tangent leans out of the needle's plane cannot be chosen.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import surg_core
from surg_core.contract import STEP
from surg_sim.arrays import Array
from surg_sim.tasks.needle_driving.curved_needle import RADIUS, arc, tangent
from surg_sim.tasks.scripted_arm import ArmExpert
from surg_sim.tasks.scripted_sender import MinimumJerk

FAR, NEAR = 0.005, 0.003
"""Distance of the point before the hole, along the arc, at the first look and the others [m]."""
THROUGH = 0.0072
"""Length of the arc behind the middle of the hole at the end [m]."""
LOOKS = 1
"""Number of looks before the hole; each halves the hand's error."""
ATTEMPTS = 8
TOUCH = 0.5
"""Force at which a needle that touches the rim is drawn back [N]."""
SPEED, ACCELERATION = 0.012, 0.06
"""Of the needle along its arc, in the hole [m/s], [m/s^2]."""
HAND = 0.001
"""Error of the hand at the hole per axis, one sigma [m]."""


class NeedleExpert(ArmExpert):
    """At the robot's console."""

    def __init__(self, cell: surg_core.Cell, seed: int, arm: str) -> None:
        super().__init__(cell, seed, arm)
        self._error = self.rng.normal(scale=HAND, size=3)
        self._reaction = float(self.rng.uniform(0.2, 0.6))

    def script(self) -> Iterator[None]:
        """See ``ArmExpert``."""
        self.jaw = self.jaw_closed
        yield from self.wait(self._reaction)
        yield from self._approach()
        for _ in range(ATTEMPTS):
            for _ in range(LOOKS):
                yield from self._go(NEAR, 0.5)
                self._error = 0.5 * self._error
                yield from self.wait(self._reaction)
            yield from self._drive(NEAR, -THROUGH)
            if not self._touched:
                return
            yield from self._drive(self._ahead, NEAR)
            yield from self.wait(self._reaction)

    def _look(self) -> None:
        """See the hole, and how the needle lies in the jaws."""
        look = self.observation
        asked = int(look.number("asked"))
        self._hole = look.point("holes")[asked] + self._error
        self._axis = look.point("axes")[asked]
        X_WT = self.tool_pose(look.point("tip"), self.me.roll)
        self._X_TN = np.linalg.inv(X_WT) @ look.point("X_WNeedle")

    def _target(self, ahead: float) -> tuple[Array, float]:
        """Place of the tip [m] and roll [rad] with the point ``ahead`` of the hole [m].

        Solved by fixed point: the shaft's direction hardly depends on the tip's place.
        """
        angle = np.pi + ahead / RADIUS
        R_TN, p_TN = self._X_TN[:3, :3], self._X_TN[:3, 3]
        p, roll = self.observation.point("tip"), self.me.roll
        for _ in range(12):
            R = self.tool_pose(p, roll)[:3, :3]
            t, s = R @ R_TN @ tangent(angle), R[:, 2]
            across = np.cross(s, t)
            roll += float(np.arctan2(self._axis @ across, self._axis @ (t - (t @ s) * s)))
            R = self.tool_pose(p, roll)[:3, :3]
            p = self._hole - R @ (R_TN @ arc(angle) + p_TN)
        return p, roll

    def _approach(self) -> Iterator[None]:
        """Turn far from the board, go past it, and only then towards it: the needle is wide."""
        self._look()
        p, roll = self._target(FAR)
        self.roll.go(np.array([roll]))
        while not self.roll.arrived:
            yield
        normal = self.observation.point("normal")
        yield from self.move(p - normal * ((p - self.observation.point("tip")) @ normal))
        yield from self._go(FAR, 1.0)

    def _go(self, ahead: float, seconds: float) -> Iterator[None]:
        """Look, and bring the point to a distance before the hole [m]."""
        self._look()
        p, roll = self._target(ahead)
        self.roll.go(np.array([roll]), seconds)
        yield from self.move(p, seconds)
        while not self.roll.arrived:
            yield

    def _drive(self, start: float, end: float) -> Iterator[None]:
        """Move the needle along its arc; ``_touched`` says whether the rim ended it, going in."""
        self._look()
        self._touched = False
        way = MinimumJerk(np.array([start]), SPEED, ACCELERATION)
        way.go(np.array([end]))
        while not way.arrived:
            self._ahead = float(way.advance(STEP)[0])
            p, roll = self._target(self._ahead)
            self.path.stay(self.local(p))
            self.roll.stay(np.array([roll]))
            yield
            if end < start and self.observation.number("rim_force") > TOUCH:
                self._touched = True
                return
        yield from self.wait(0.2)
