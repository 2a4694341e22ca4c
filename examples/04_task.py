#!/usr/bin/env python3
"""Step 4: a task of your own in one file: touch a ball with the tip of the instrument.

You learn: how a task adds things to the scene, draws an episode, measures success and scripts an
expert. docs/guide/adding_a_task.md explains every method.

    ./surg dev shell -c "python3 examples/04_task.py"          # without ROS
    ./surg run examples/04_task.py --episodes 3            # through the ROS graph, recorded
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

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
    """Success: the tip has been inside the ball. Otherwise the time limit ends the episode."""

    name = "touch"
    title = "Touch the ball"
    instruction = "Touch the ball with the tip of the instrument."
    time_limit = 5.0
    home_cell = "sim_ur5e"

    def add(self, spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
        """Add a ball that each episode can place anywhere: a mocap body."""
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
        """Find ball and tip in the compiled scene."""
        self._data = world.data
        self._ball = int(world.model.body("ball").mocapid[0])
        self._tip = int(world.model.body("PSM1_tip").id)

    def reset(self, rng: np.random.Generator) -> None:
        """Place the ball 15 to 25 mm from the work point, where the tip is at home."""
        super().reset(rng)
        direction = rng.normal(size=3)
        offset = rng.uniform(0.015, 0.025) * direction / np.linalg.norm(direction)
        self._data.mocap_pos[self._ball] = self._site.place(offset)
        self._touched = False

    def advance(self) -> None:
        """Check in every tick whether the tip is in the ball."""
        super().advance()
        away = self._data.xpos[self._tip] - self._data.mocap_pos[self._ball]
        self._touched |= float(np.linalg.norm(away)) < RADIUS

    def state(self) -> State:
        """Return the positions of ball and tip in the world frame [m]."""
        ball, tip = self._data.mocap_pos[self._ball], self._data.xpos[self._tip]
        return {"ball": np.array(ball), "tip": np.array(tip)}

    def verdict(self) -> Verdict:
        """Return success, the time limit, or that the episode goes on."""
        if self._touched:
            return Verdict(done=True, success=True, reward=1.0, phase="done")
        return self.late("reach") or Verdict(phase="reach")

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """Return the one scripted sender, which moves the robot."""
        return {"expert": TouchExpert(cell, seed, "PSM1")}


class TouchExpert(ArmExpert):
    """Moves the tip to the ball."""

    def script(self) -> Iterator[None]:
        """Yield once per action; see ``ArmExpert``."""
        yield from self.move(self.observation.point("ball"), slowest=0.8)


def main() -> None:
    """Play three episodes."""
    from surg_sim.envs.cell_session import CellSession
    from surg_sim.envs.episode_runner import run_episode
    from surg_sim.physics import cell_files

    session = CellSession(cell_files.find(Touch.home_cell), str(Path(__file__).resolve()))
    for seed in (10_000, 10_001, 10_002):
        report = run_episode(session, seed)
        deviation = 1e3 * report.arms["PSM1"].kinematic.max
        outcome = "success" if report.success else report.reason
        print(
            f"seed {seed}: {outcome} in {report.duration:.2f} s, RCM deviation {deviation:.3f} mm"
        )


if __name__ == "__main__":
    main()
