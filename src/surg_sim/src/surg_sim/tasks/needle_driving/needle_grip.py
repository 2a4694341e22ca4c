"""Jaws that hold a needle with limited strength.

The hold is a weld whose rest pose yields: above a limit of force the needle slides in the jaws,
above a limit of torque it turns in them, as an elastic, perfectly plastic joint does. A needle that
has slid or turned too far falls, and so does one whose jaws open.
"""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.arrays import Array
from surg_sim.tasks.jaw_weld import JawWeld, between, rotation, times
from surg_sim.tasks.needle_driving.curved_needle import NEEDLE, arc

GRIP_ANGLE = np.radians(60.0)
"""Where on the arc the jaws hold: a third of the needle from its rear end [rad]."""
GRIP_DEPTH = 0.002
"""Behind the tip on the shaft axis [m]."""
SLIDE_FORCE, TURN_TORQUE = 1.5, 0.012
"""Load above which the needle slides [N] and turns [N m] in the jaws; assumed."""
LARGEST_SLIDE, LARGEST_TURN = 0.003, np.radians(45.0)
"""A needle that has slid [m] or turned [rad] further is dropped; assumed."""
SHIFT, TURN = 0.0005, np.radians(5.0)
"""Largest error of the drawn grasp: along the needle and the shaft [m]; about both [rad]."""


class NeedleGrip(JawWeld):
    """The hold of one jawed tool on the needle in a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: str, tip: str) -> None:
        super().__init__(model, data, arm, tip, NEEDLE)

    def reset(self, rng: np.random.Generator) -> None:
        """Take the needle as drawn; the arms' kinematics are up to date."""
        along, deep = rng.uniform(-SHIFT, SHIFT, 2)
        about_shaft, about_needle = rng.uniform(-TURN, TURN, 2)
        self._angle = float(GRIP_ANGLE + along / np.linalg.norm(arc(0.0)))
        # z of N along the shaft, and the arc's radius at the grip along y of the tip.
        nominal = rotation(np.array([0.0, 0.0, np.pi / 2 - self._angle + about_shaft]))
        self._rest = times(rotation(np.array([about_needle, 0.0, 0.0])), nominal)
        self._at = np.array([0.0, 0.0, -GRIP_DEPTH + deep])
        self._first = self._rest.copy(), self._at.copy()
        self.take(arc(self._angle), self._at, self._rest)

    @property
    def place(self) -> Array:
        """Point of the needle that the jaws hold, world [m], (3,)."""
        R = self._data.xmat[self._body].reshape(3, 3)
        return np.asarray(self._data.xpos[self._body] + R @ arc(self._angle))

    @property
    def slid(self) -> float:
        """How far the needle has slid in the jaws [m]."""
        return float(np.linalg.norm(self._at - self._first[1]))

    @property
    def turned(self) -> float:
        """How far it has turned in them [rad]."""
        return float(np.linalg.norm(between(self._rest, self._first[0])))

    def advance(self, force: Array, torque: Array) -> None:
        """Yield to the load on the needle; called before the physics of each tick.

        Force (3,) [N] and torque about ``place`` (3,) [N m] of the board on the needle, world.
        """
        if not self.held:
            return
        if self.open or self.slid > LARGEST_SLIDE or self.turned > LARGEST_TURN:
            self.let_go()
            return
        slides = 1.0 - SLIDE_FORCE / max(float(np.linalg.norm(force)), SLIDE_FORCE)
        turns = 1.0 - TURN_TORQUE / max(float(np.linalg.norm(torque)), TURN_TORQUE)
        if slides > 0.0:
            R_WT = self._data.xmat[self._tip].reshape(3, 3)
            now = R_WT.T @ (self.place - self._data.xpos[self._tip])
            self._at = self._at + slides * (now - self._at)
        if turns > 0.0:
            back = np.empty(4)
            mujoco.mju_negQuat(back, self._data.xquat[self._tip])
            now = times(back, self._data.xquat[self._body])
            self._rest = times(rotation(turns * between(now, self._rest)), self._rest)
        if slides > 0.0 or turns > 0.0:
            self.pose(arc(self._angle), self._at, self._rest)
