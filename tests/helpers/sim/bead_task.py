"""A task that is only a glowing 2 mm bead on three slides: what a test of the cameras looks at."""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.physics.scene import Site
from surg_sim.physics.world import World
from surg_sim.tasks import State, Task, Verdict

BEAD = "bead"
RADIUS = 0.001


class BeadTask(Task):
    """Nothing to do."""

    name = "bead"
    title = "A bead to look at"
    time_limit = 3600.0
    commanded = ()

    def add(self, spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
        """The bead at the work point; its slides run along the world's axes."""
        del visuals
        spec.add_material(name=BEAD, emission=1.0, rgba=[0, 1, 0, 1])
        body = spec.worldbody.add_body(name=BEAD, pos=site.work.tolist(), gravcomp=1.0)
        for axis, letter in zip(np.eye(3), "xyz", strict=True):
            body.add_joint(
                name=f"{BEAD}_{letter}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis.tolist()
            )
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[RADIUS, 0, 0],
            material=BEAD,
            contype=0,
            conaffinity=0,
            mass=0.001,
        )

    def bind(self, world: World) -> None:
        """Nothing to find."""

    def reset(self, rng: np.random.Generator) -> None:
        """Nothing to draw."""
        super().reset(rng)

    def state(self) -> State:
        """Nothing to tell."""
        return {}

    def verdict(self) -> Verdict:
        """Never done."""
        return Verdict()
