"""Bowel grasping and retraction: the paper's collaborative task.

The assistant points at a target and the robot grasps there. The robot holds while the assistant
grasps beside it. Both retract until the tissue between them is taut and visible, and hold still for
2 s. docs/reference/tasks.md defines success; ``bgr_definition`` holds its numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np

import surg_core
from surg_core.contract import GRID, TICK
from surg_sim.appearance.tissue_skin import BowelSkin, add_skin
from surg_sim.arrays import Array
from surg_sim.physics.assistant_arm import Assistant
from surg_sim.physics.assistant_scene import add_assistant
from surg_sim.physics.bowel import Bowel
from surg_sim.physics.endoscope_projection import EndoscopeView
from surg_sim.physics.patient_site import Site
from surg_sim.physics.tissue import add_bowel
from surg_sim.physics.tissue_grasp import Grasp, add_grasp
from surg_sim.tasks.bgr import bgr_definition as defined
from surg_sim.tasks.bgr.bgr_definition import ASSISTANT, NOBODY, PHASES, ROBOT
from surg_sim.tasks.bgr.bgr_expert import AssistantExpert, RobotExpert
from surg_sim.tasks.task import State, Task, Verdict

if TYPE_CHECKING:
    from surg_sim.physics.patient_settings import PatientSetting
    from surg_sim.physics.world import World
    from surg_sim.tasks.scripted_sender import Expert


class Bgr(Task):
    """See the module."""

    name = "bgr"
    title = "Bowel grasping and retraction"
    instruction = defined.INSTRUCTION
    stages: ClassVar[Mapping[str, str]] = defined.STAGES
    time_limit = 45.0
    jaws = ROBOT
    plotted: ClassVar[Mapping[str, str]] = {"tension": "N", "still": "s"}

    def prepare(self, cell: surg_core.Cell, setting: PatientSetting) -> None:
        """Any endoscope will do, also one that stands."""
        super().prepare(cell, setting)
        self._tissue, self._breathing = setting.tissue, setting.breathing
        self._urdf = cell.arms[ROBOT].instrument_urdf

    def add(self, spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
        """Bowel, the assistant's instrument, both holds."""
        self._site, self._visuals = site, visuals
        add_bowel(spec, site, self._tissue)
        if visuals:
            add_skin(spec, site, self._tissue)
        add_assistant(spec, site, self._urdf, visuals)
        add_grasp(spec, ROBOT, self.tip_link)
        add_grasp(spec, ASSISTANT)

    def bind(self, world: World) -> None:
        """Find everything in the compiled scene."""
        model, data = world.model, world.data
        self._data = data
        self.bowel = Bowel(model, data, self._site, self._tissue)
        self.assistant = Assistant(model, data)
        self.grasps = {name: Grasp(model, data, name, self.bowel) for name in (ROBOT, ASSISTANT)}
        self.view = EndoscopeView(model, data)
        if self._visuals:
            self.skins = [BowelSkin(model, self._site, self._tissue)]
        self.find_tip(world)

    def reset(self, rng: np.random.Generator) -> None:
        """A new shape of the bowel, a new place in it; the bed breathes as the setting says."""
        super().reset(rng)
        for grasp in self.grasps.values():
            grasp.reset()
        self.bowel.reset(rng)
        self.bowel.bed.move(self._breathing.bed())
        self.target = int(rng.integers(defined.TARGETS[0], defined.TARGETS[1] + 1))
        self.assistant.reset()
        self.phase = "point"
        self._failure = ""
        self._pointing = self._still = 0
        self._places: Array | None = None
        self.tension, self.visible = 0.0, False

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """Two: at the robot, and at the assistant's instrument."""
        return {"assistant": AssistantExpert(seed), "expert": RobotExpert(cell, seed)}

    def jaw_force(self, arm: str) -> Array | None:
        """Of the tissue on the robot's jaws."""
        return self.grasps[ROBOT].force if arm == ROBOT else None

    def held(self, who: str) -> int | None:
        """The node that an instrument holds."""
        return self.grasps[who].held

    def advance(self) -> None:
        """Instruments, tissue, phases."""
        super().advance()
        self.assistant.advance()
        for grasp in self.grasps.values():
            grasp.advance()
        self.bowel.advance()
        self._watch_holds()
        if self.on_grid:
            self._look()

    def _watch_holds(self) -> None:
        """Every tick: who has taken, and who has lost."""
        robot, other = self.held(ROBOT), self.held(ASSISTANT)
        stage = PHASES.index(self.phase)
        if stage <= PHASES.index("grasp") and robot is not None:
            self.phase, stage = "assist", PHASES.index("assist")
        if self._failure or self.phase == "done" or stage < PHASES.index("assist"):
            return
        if robot is None:
            self._failure = "the robot lost its grasp"
        elif abs(robot - self.target) > defined.RIGHT:
            self._failure = f"wrong place: node {robot} is held, {self.target} was pointed at"
        elif stage >= PHASES.index("retract") and other is None:
            self._failure = "the assistant lost its grasp"
        elif (
            self.phase == "assist"
            and other is not None
            and abs(other - robot) >= defined.LEAST_APART
        ):
            self.phase = "retract"

    def _look(self) -> None:
        """20 times a second: pointing, tension, view, stillness."""
        tips = np.array([self.tip, self.assistant.p_WTip])
        moved = np.full(2, np.inf) if self._places is None else tips - self._places
        speed = np.max(np.linalg.norm(np.atleast_2d(moved), axis=-1)) / (GRID * TICK)
        self._places = tips
        if self.phase == "point":
            away = float(np.linalg.norm(tips[1] - self.bowel.nodes[self.target]))
            self._pointing = self._pointing + 1 if away <= defined.POINT_AT else 0
            if self._pointing * GRID * TICK >= defined.POINT_FOR:
                self.phase = "grasp"
        robot, other = self.held(ROBOT), self.held(ASSISTANT)
        self.tension, self.visible = 0.0, False
        if robot is None or other is None or robot == other:
            self._still = 0
            return
        first, last = sorted((robot, other))
        self.tension = float(self.bowel.tensions[first:last].min())
        self.visible = self.view.sees(self.bowel.nodes[first : last + 1])
        if self.phase not in ("retract", "still") or self._failure:
            return
        shown = self.tension >= defined.TAUT and self.visible
        self.phase = "still" if shown else "retract"
        self._still = self._still + 1 if shown and speed <= defined.STILL_SPEED else 0
        if self._still * GRID * TICK >= defined.STILL_FOR:
            self.phase = "done"

    def state(self) -> State:
        """Points and forces in the world [m, N]; nodes by their number, -1 for none."""
        robot, other = self.held(ROBOT), self.held(ASSISTANT)
        return {
            "target": float(self.target),
            "held": NOBODY if robot is None else float(robot),
            "assistant_held": NOBODY if other is None else float(other),
            "tip": self.tip,
            "force": self.grasps[ROBOT].force,
            "assistant_tip": self.assistant.p_WTip,
            "assistant_force": self.grasps[ASSISTANT].force,
            "assistant_joints": self.assistant.joints,
            "assistant_jaw": self.assistant.jaw,
            "X_WAssistant": self.assistant.X_WRcm.copy(),
            "tension": self.tension,
            "visible": float(self.visible),
            "still": self._still * GRID * TICK,
            "slips": float(sum(grasp.slips for grasp in self.grasps.values())),
            "nodes": self.bowel.nodes,
        }

    def verdict(self) -> Verdict:
        """Success, failure with its cause, late, or going on."""
        if self.phase == "done":
            return Verdict(done=True, success=True, reward=1.0, phase="done")
        if self._failure:
            return Verdict(done=True, reason=self._failure, phase=self.phase)
        return self.late(self.phase) or Verdict(phase=self.phase)
