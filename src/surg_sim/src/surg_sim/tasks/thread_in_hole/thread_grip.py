"""Jaws that hold a thread until they open: a weld between the tip and the thread's root."""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.tasks.jaw_weld import OPEN, rotation, times
from surg_sim.tasks.thread_in_hole.surgical_thread import THREAD

GRIP_DEPTH = 0.002
"""Behind the tip on the shaft axis [m]."""
SHIFT, TURN = 0.0005, np.radians(5.0)
"""Largest error of the drawn grasp: along the shaft [m]; about two axes [rad]."""


class ThreadGrip:
    """The hold of one jawed tool on the thread in a compiled scene.

    Attributes:
        held: Whether the jaws hold the thread.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: str, tip: str) -> None:
        self._model, self._data = model, data
        self._tip = int(model.body(f"{arm}_{tip}").id)
        self._jaw = int(model.joint(f"{arm}_jaw").qposadr[0])
        self._weld = int(model.equality(f"{arm}_holds_{THREAD}").id)
        self._free = int(model.joint(THREAD).qposadr[0])
        self.held = False

    def reset(self, rng: np.random.Generator) -> None:
        """Take the thread as drawn; the arms' kinematics are up to date."""
        data = self._data
        about_shaft, about_jaw = rng.uniform(-TURN, TURN, 2)
        # Pinched along x of the tip, across the direction in which the jaws open.
        turn = times(
            rotation(np.array([0.0, about_jaw, 0.0])), rotation(np.array([0.0, 0.0, about_shaft]))
        )
        at = np.array([0.0, 0.0, -GRIP_DEPTH + rng.uniform(-SHIFT, SHIFT)])
        # Point of the thread, its place in the tip's frame, pose of the root in it, torque scale.
        self._model.eq_data[self._weld, :11] = [0.0, 0.0, 0.0, *at, *turn, 1.0]
        data.eq_active[self._weld] = 1
        R_WT = data.xmat[self._tip].reshape(3, 3)
        data.qpos[self._free : self._free + 3] = data.xpos[self._tip] + R_WT @ at
        data.qpos[self._free + 3 : self._free + 7] = times(data.xquat[self._tip], turn)
        self.held = True

    def advance(self) -> None:
        """Let go when the jaws are open; called before the physics of each tick."""
        if self.held and float(self._data.qpos[self._jaw]) > OPEN:
            self.held = False
            self._data.eq_active[self._weld] = 0
