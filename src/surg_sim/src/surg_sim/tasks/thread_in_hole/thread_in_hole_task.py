"""Thread in hole: guide the end of a surgical thread through the hole of a printed figure.

Success: the thread's end has gone through the hole from the front and is behind it by at least 5 mm
for half a second, in jaws that hold the thread, within the time limit. The thread is in the jaws
from the beginning.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np

import surg_core
from surg_core.contract import TICK
from surg_sim.physics.patient_site import Site
from surg_sim.tasks.jaw_weld import add_jaw_weld
from surg_sim.tasks.task import State, Task, Verdict
from surg_sim.tasks.thread_in_hole.printed_figure import (
    HOLE_RADIUS,
    THICKNESS,
    PrintedFigure,
    add_figure,
)
from surg_sim.tasks.thread_in_hole.surgical_thread import THREAD, SurgicalThread, add_thread
from surg_sim.tasks.thread_in_hole.thread_grip import ThreadGrip
from surg_sim.tasks.thread_in_hole.thread_in_hole_expert import ThreadExpert

if TYPE_CHECKING:
    from surg_sim.physics.world import World
    from surg_sim.tasks.scripted_sender import Expert

ARM = "PSM1"
PASSED = 0.005
"""How far the thread's end must be behind the hole, along the hole's axis [m]."""
FOR = 0.5
"""So long it must be there [s]."""


class ThreadInHole(Task):
    """See the module."""

    name = "thread_in_hole"
    title = "Thread in hole"
    instruction = "Guide the end of the thread through the hole of the figure."
    stages: ClassVar[Mapping[str, str]] = {
        "place": "Bring the end of the thread to the hole.",
        "pass": "Push the thread through the hole.",
        "hold": "Hold the thread still with its end behind the hole.",
    }
    time_limit = 60.0
    home_cell = "sim_ur5e"
    jaws = ARM
    plotted: ClassVar[Mapping[str, str]] = {"depth": "m"}

    def add(self, spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
        """The figure, the thread, and the jaws' hold on it."""
        add_figure(spec, site, visuals)
        add_thread(spec, site.work)
        add_jaw_weld(spec, ARM, self.tip_link, THREAD)

    def bind(self, world: World) -> None:
        """Find thread, figure and tip."""
        self._model, self._data = world.model, world.data
        self.find_tip(world)
        self.figure = PrintedFigure(world.model, world.data)
        self.thread = SurgicalThread(world.model, world.data)
        self.grip = ThreadGrip(world.model, world.data, ARM, self.tip_link)

    def reset(self, rng: np.random.Generator) -> None:
        """Draw the figure, the thread's curl and the grasp."""
        super().reset(rng)
        self.figure.reset(rng)
        self.thread.reset(rng)
        self.grip.reset(rng)
        mujoco.mj_kinematics(self._model, self._data)
        self._passages = 0  # of the end through the hole: from the front 1, from behind -1
        self._before = self.figure.inside(self.thread.end)
        self._behind = 0

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """One: at the robot."""
        return {"expert": ThreadExpert(cell, seed, ARM)}

    @property
    def depth(self) -> float:
        """How far the end is behind the hole [m]; minus the thickness: not through it."""
        if self._passages != 1:
            return -THICKNESS
        return float(self.figure.inside(self.thread.end)[2]) - THICKNESS / 2

    def advance(self) -> None:
        """The grip, and whether the thread's end is in the hole."""
        super().advance()
        self.grip.advance()
        before, now = self._before, self.figure.inside(self.thread.end)
        if (before[2] < 0.0) != (now[2] < 0.0):
            share = before[2] / (before[2] - now[2])
            crossing = before[:2] + share * (now[:2] - before[:2])
            if np.hypot(*crossing) < HOLE_RADIUS:
                self._passages += 1 if now[2] >= 0.0 else -1
        self._before = now
        self._behind = self._behind + 1 if self.depth >= PASSED and self.grip.held else 0

    def state(self) -> State:
        """World frame, SI: see docs/reference/tasks.md."""
        return {
            "tip": self.tip,
            "end": self.thread.end,
            "direction": self.thread.direction,
            "hole": self.figure.hole,
            "axis": self.figure.axis,
            "depth": self.depth,
            "held": float(self.grip.held),
            "nodes": self.thread.nodes,
        }

    @property
    def _phase(self) -> str:
        if self._passages != 1:
            return "place"
        return "hold" if self.depth >= PASSED else "pass"

    def verdict(self) -> Verdict:
        """Success, dropped, late, or going on."""
        phase = self._phase
        if not self.grip.held:
            return Verdict(done=True, reason="the thread was dropped", phase=phase)
        if self._behind * TICK >= FOR:
            return Verdict(done=True, success=True, reward=1.0, phase="done")
        return self.late(phase) or Verdict(phase=phase)
