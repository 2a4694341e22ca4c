"""Needle driving: drive a curved needle through the marked one of four holes in a board.

Success: the needle's point has gone through the asked hole from the front and stands out behind it
by at least 4 mm for half a second, within the time limit, and the force between needle and board
has never been above its limit. The needle is in the jaws from the beginning.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np

import surg_core
from surg_core.contract import TICK
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.tasks.jaw_weld import add_jaw_weld
from surg_sim.tasks.needle_driving.curved_needle import NEEDLE, add_needle, arc
from surg_sim.tasks.needle_driving.needle_board import (
    HOLE_RADIUS,
    HOLES,
    THICKNESS,
    NeedleBoard,
    add_board,
)
from surg_sim.tasks.needle_driving.needle_driving_expert import NeedleExpert
from surg_sim.tasks.needle_driving.needle_grip import NeedleGrip
from surg_sim.tasks.task import State, Task, Verdict

if TYPE_CHECKING:
    from surg_sim.physics.world import World
    from surg_sim.tasks.scripted_sender import Expert

ARM = "PSM1"
STANDS_OUT = 0.004
"""Length of the needle's point behind the hole, along the hole's axis [m]."""
FOR = 0.5
"""So long it must stand out [s]."""
RIM_FORCE = 2.0
"""Largest force between needle and board [N]; assumed."""
FORCE_FILTER = 0.020
"""Time constant of the low-pass filter of that force [s]: blows are shorter; assumed."""


class NeedleDriving(Task):
    """See the module."""

    name = "needle_driving"
    title = "Needle driving"
    instruction = "Drive the needle through the marked hole, along its own curve."
    stages: ClassVar[Mapping[str, str]] = {
        "place": "Bring the needle's point before the marked hole.",
        "drive": "Drive the needle through the hole along its curve.",
        "hold": "Hold the needle still with its point behind the board.",
    }
    time_limit = 60.0
    home_cell = "sim_ur5e"
    jaws = ARM
    plotted: ClassVar[Mapping[str, str]] = {"depth": "m", "rim_force": "N"}

    def add(self, spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
        """The board, the needle, and the jaws' hold on it."""
        add_board(spec, site, visuals)
        add_needle(spec, site.work)
        add_jaw_weld(spec, ARM, self.tip_link, NEEDLE)

    def bind(self, world: World) -> None:
        """Find needle, board and tip."""
        model, self._data = world.model, world.data
        self._model = model
        self._needle = int(model.body(NEEDLE).id)
        first = int(model.joint(NEEDLE).dofadr[0])
        self._free = slice(first, first + 6)
        self.find_tip(world)
        self.board = NeedleBoard(model, world.data)
        self.grip = NeedleGrip(model, world.data, ARM, self.tip_link)
        self._keep = math.exp(-TICK / FORCE_FILTER)

    def reset(self, rng: np.random.Generator) -> None:
        """Draw holes, the asked one and the grasp."""
        super().reset(rng)
        self.asked = self.board.reset(rng)
        self.grip.reset(rng)
        mujoco.mj_kinematics(self._model, self._data)
        self._force = np.zeros(3)
        self._largest = 0.0
        self._through = [0] * HOLES  # 1: the point went in from the front, -1: from behind
        self._before = [self._in_hole(hole) for hole in range(HOLES)]
        self._out = 0

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """One: at the robot."""
        return {"expert": NeedleExpert(cell, seed, ARM)}

    @property
    def point(self) -> Array:
        """The needle's point, world [m], (3,)."""
        R = self._data.xmat[self._needle].reshape(3, 3)
        return np.asarray(self._data.xpos[self._needle] + R @ arc(np.pi))

    def _in_hole(self, hole: int) -> Array:
        """The needle's point in the frame of a hole [m], (3,)."""
        X = self.board.poses[hole]
        return np.asarray(X[:3, :3].T @ (self.point - X[:3, 3]))

    @property
    def depth(self) -> float:
        """How far the point stands out behind the asked hole [m]; negative: not behind it."""
        if self._through[self.asked] != 1:
            return -THICKNESS
        return float(self._in_hole(self.asked)[2]) - THICKNESS / 2

    def advance(self) -> None:
        """Load on the needle, the grip's answer to it, and which holes the point is in."""
        super().advance()
        force, torque = self.board.load(self.grip.place)
        self._force = self._keep * self._force + (1.0 - self._keep) * force
        self._largest = max(self._largest, float(np.linalg.norm(self._force)))
        self.grip.advance(force, torque)
        for hole in range(HOLES):
            before, now = self._before[hole], self._in_hole(hole)
            if (before[2] < 0.0) != (now[2] < 0.0) and np.hypot(*now[:2]) < HOLE_RADIUS:
                self._through[hole] += 1 if now[2] >= 0.0 else -1
            self._before[hole] = now
        self._out = self._out + 1 if self.depth >= STANDS_OUT and self.grip.held else 0

    def state(self) -> State:
        """World frame, SI: see docs/reference/tasks.md."""
        R_WNeedle = self._data.xmat[self._needle].reshape(3, 3)
        poses = self.board.poses
        return {
            "tip": self.tip,
            "point": self.point,
            "X_WNeedle": surg_core.make_pose(self._data.xpos[self._needle], R_WNeedle),
            "needle_velocity": np.array(self._data.qvel[self._free][:3]),
            "asked": float(self.asked),
            "holes": np.array([pose[:3, 3] for pose in poses]),
            "axes": np.array([pose[:3, 2] for pose in poses]),
            "normal": self.board.normal,
            "depth": self.depth,
            "rim_force": float(np.linalg.norm(self._force)),
            "slid": self.grip.slid,
            "turned": self.grip.turned,
            "held": float(self.grip.held),
        }

    def jaw_force(self, arm: str) -> Array | None:
        """What the jaws feel through the needle that they hold."""
        if arm != ARM:
            return None
        return self._force.copy() if self.grip.held else np.zeros(3)

    @property
    def _phase(self) -> str:
        if self._through[self.asked] != 1:
            return "place"
        return "hold" if self.depth >= STANDS_OUT else "drive"

    def verdict(self) -> Verdict:
        """Success, wrong hole, dropped, rim force, late, or going on."""
        phase = self._phase
        if self._largest > RIM_FORCE:
            reason = f"more than {RIM_FORCE:g} N between needle and board"
            return Verdict(done=True, reason=reason, phase=phase)
        if not self.grip.held:
            return Verdict(done=True, reason="the needle was dropped", phase=phase)
        for hole, through in enumerate(self._through):
            if through > 0 and hole != self.asked:
                return Verdict(done=True, reason="the needle is in the wrong hole", phase=phase)
            if through < 0:
                reason = "the needle came through a hole from behind"
                return Verdict(done=True, reason=reason, phase=phase)
        if self._out * TICK >= FOR:
            return Verdict(done=True, success=True, reward=1.0, phase="done")
        return self.late(phase) or Verdict(phase=phase)
