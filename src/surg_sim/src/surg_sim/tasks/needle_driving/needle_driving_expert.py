"""The script of needle driving: look, place the point, drive along the arc, back out, try again.

The needle is rigid in the jaws. The tip's place and the roll put a point of its arc into the hole
with its tangent in the plane of the hole's axis. What is left between tangent and axis takes a
wrist: behind one the tool leans until there is nothing left, all through the arc.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator

import numpy as np

import surg_core
from surg_core.contract import STEP
from surg_core.transforms import minimal_rotation, rotation_vector
from surg_sim.arrays import Array
from surg_sim.tasks.hole_expert import HoleExpert, turn_onto
from surg_sim.tasks.needle_driving.curved_needle import RADIUS, arc, tangent
from surg_sim.tasks.scripted_sender import MinimumJerk

FAR, NEAR = 0.005, 0.003
"""Distance of the point before the hole, along the arc, at the first look and the others [m]."""
THROUGH = 0.0072
"""Length of the arc behind the middle of the hole at the end [m]."""
LOOKS = 1
"""Number of looks before the hole; each halves the hand's error."""
TOUCH = 0.5
"""Force at which a needle that touches the rim is drawn back [N]."""
SPEED, ACCELERATION = 0.012, 0.06
"""Of the needle along its arc, in the hole [m/s], [m/s^2]."""


class NeedleExpert(HoleExpert):
    """See ``HoleExpert``."""

    far, near, looks = FAR, NEAR, LOOKS

    def __init__(self, cell: surg_core.Cell, seed: int, arm: str) -> None:
        super().__init__(cell, seed, arm)
        if cell.arms[arm].instrument.wrist is not None:
            self.lean = np.zeros(3)

    def _look(self) -> None:
        """See the hole, and how the needle lies in the jaws."""
        look = self.observation
        asked = int(look.number("asked"))
        self._hole = look.point("holes")[asked] + self._error
        self._axis = look.point("axes")[asked]
        X_WT = self.measured_tool(look.point("tip"))
        self._X_TN = np.linalg.inv(X_WT) @ look.point("X_WNeedle")

    def _target(self, ahead: float) -> tuple[Array, Array]:
        """Place of the tip [m] and its turns with the point ``ahead`` of the hole [m].

        Solved by fixed point: the shaft's direction hardly depends on the tip's place.
        """
        angle = np.pi + ahead / RADIUS
        R_TN, p_TN = self._X_TN[:3, :3], self._X_TN[:3, 3]
        R_WR = self.X_WR[:3, :3]
        p, turns = self.observation.point("tip"), np.array([self.me.roll])
        for _ in range(12):
            R = self.tool_pose(p, turns[:1])[:3, :3]
            t, s = R @ R_TN @ tangent(angle), R[:, 2]
            turns = turns[:1] + turn_onto(self._axis, t, s)
            if len(self.lean):
                t = self.tool_pose(p, turns)[:3, :3] @ R_TN @ tangent(angle)
                leant = minimal_rotation(t, self._axis)
                turns = np.append(turns, rotation_vector(R_WR.T @ leant @ R_WR))
            R = self.tool_pose(p, turns)[:3, :3]
            p = self._hole - R @ (R_TN @ arc(angle) + p_TN)
        return p, turns

    def _clear_way(self) -> Array:
        """Across the board."""
        return self.observation.point("normal")

    def _enter(self) -> Generator[None, None, bool]:
        """Drive, and draw back a needle that touched the rim."""
        yield from self._drive(NEAR, -THROUGH)
        if self._touched:
            yield from self._drive(self._ahead, NEAR)
            yield from self.wait(self._reaction)
            return False
        return True

    def _drive(self, start: float, end: float) -> Iterator[None]:
        """Move the needle along its arc; ``_touched`` says whether the rim ended it, going in."""
        self._look()
        self._touched = False
        way = MinimumJerk(np.array([start]), SPEED, ACCELERATION)
        way.go(np.array([end]))
        while not way.arrived:
            self._ahead = float(way.advance(STEP)[0])
            self._put(*self._target(self._ahead))
            yield
            if end < start and self.observation.number("rim_force") > TOUCH:
                self._touched = True
                return
        yield from self.wait(0.2)
