"""Bowel grasping and retraction in which something pushes the robot's jaws from tick 700 on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surg_sim.tasks.bgr import bgr_task

FROM = 700
PUSH = 6.0
"""Above the soft limit of the bundled robots, below the hard one [N]."""


class PushedBgr(bgr_task.Bgr):
    """As bgr, for two seconds."""

    name = "pushed_bgr"
    title = "The first seconds of bowel grasping and retraction, pushed"
    time_limit = 2.0

    def jaw_force(self, arm: str) -> NDArray[np.float64] | None:
        """Up, on the robot only."""
        if arm != bgr_task.ROBOT:
            return None
        return np.array([0.0, 0.0, PUSH if self.tick >= FROM else 0.0])
