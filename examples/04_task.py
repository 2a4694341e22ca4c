"""A task in one file: touch a ball with the instrument's tip. See docs/guide/adding_a_task.md."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np

import surg_core
from surg_sim.physics.scene import Site
from surg_sim.physics.world import World
from surg_sim.tasks import State, Task, Verdict
from surg_sim.tasks.scripted_arm import ArmExpert
from surg_sim.tasks.scripted_sender import Expert

RADIUS = 0.004  # [m]


class Touch(Task):
    """Success: the tip has been inside the ball. Nothing else ends it but the time limit."""

    name = "touch"
    title = "Touch the ball"
    time_limit = 5.0
    home_cell = "sim_ur5e"

    def add(self, spec: mujoco.MjSpec, site: Site, looks: bool) -> None:
        """A ball that an episode can put anywhere: a mocap body."""
        self._site = site
        ball = spec.worldbody.add_body(name="ball", mocap=True, pos=site.work.tolist())
        ball.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[RADIUS, 0, 0],
            rgba=[0.9, 0.8, 0.1, 1],
            contype=0,
            conaffinity=0,
        )

    def bind(self, world: World) -> None:
        """Where ball and tip are in the compiled scene."""
        self._data = world.data
        self._ball = int(world.model.body("ball").mocapid[0])
        self._tip = int(world.model.body("PSM1_tip").id)

    def reset(self, rng: np.random.Generator) -> None:
        """The ball somewhere round the work point."""
        super().reset(rng)
        self._data.mocap_pos[self._ball] = self._site.place(rng.uniform(-0.02, 0.02, 3))
        self._touched = False

    def advance(self) -> None:
        """In every tick: is the tip in the ball?"""
        super().advance()
        away = self._data.xpos[self._tip] - self._data.mocap_pos[self._ball]
        self._touched |= float(np.linalg.norm(away)) < RADIUS

    def state(self) -> State:
        """Both in the world [m]."""
        ball, tip = self._data.mocap_pos[self._ball], self._data.xpos[self._tip]
        return {"ball": np.array(ball), "tip": np.array(tip)}

    def verdict(self) -> Verdict:
        """Touched, late, or going on."""
        if self._touched:
            return Verdict(done=True, success=True, reward=1.0, phase="done")
        return self.late("reach") or Verdict(phase="reach")

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """One sender, at the robot."""
        return {"expert": TouchExpert(cell, seed, "PSM1")}


class TouchExpert(ArmExpert):
    """Goes to the ball."""

    def script(self) -> Iterator[None]:
        """See ``ArmExpert``."""
        yield from self.move(self.observation.point("ball"), slowest=0.8)
