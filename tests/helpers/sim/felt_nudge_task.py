"""`nudge_task.py` in which something pulls at the first arm's jaws, by a formula of the tick."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from nudge_task import Nudge

ARM = "PSM1"


def pull(tick: int) -> NDArray[np.float64]:
    """Force on the jaws in the world [N], (3,); below the soft limit."""
    return np.array([1.5 * np.sin(0.02 * tick), 1.0 - 0.001 * tick, 0.5 * np.cos(0.013 * tick)])


class FeltNudge(Nudge):
    """As nudge; nothing is felt at the second arm's jaws."""

    name = "felt_nudge"
    title = "Felt nudge"

    def jaw_force(self, arm: str) -> NDArray[np.float64] | None:
        """By the formula."""
        return pull(self.tick) if arm == ARM else None
