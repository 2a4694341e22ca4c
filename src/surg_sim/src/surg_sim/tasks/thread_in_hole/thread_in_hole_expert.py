"""The script of thread in hole: look, aim the thread's end, push it through, draw back, try again.

The tip's place and the roll put the end of the thread before the hole and turn the thread about the
shaft; how far it leans out of that plane cannot be chosen. The thread sags and swings, so the
script waits until it hangs still, looks at where its end really is, and corrects.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator

import numpy as np

from surg_core.contract import STEP
from surg_sim.arrays import Array
from surg_sim.tasks.hole_expert import HoleExpert, turn_onto
from surg_sim.tasks.thread_in_hole.surgical_thread import GRIP, PIECE

FAR, NEAR = 0.008, 0.003
"""Distance of the thread's end before the middle of the hole, first and at the later looks [m]."""
MOST = 0.016
"""Largest length of thread that is pushed through [m]."""
ENOUGH = 0.0065
"""Depth of the end behind the hole at which pushing ends [m]."""
LOOKS = 2
"""Number of looks before the hole; each halves the hand's error."""
BENT = 0.005
"""An end so far from where unbent thread would have it has met the figure [m]."""
SPEED = 0.012
"""Of the thread through the hole [m/s]."""
HOLD = 0.7
"""So long it stays behind the hole [s]."""


class ThreadExpert(HoleExpert):
    """See ``HoleExpert``."""

    far, near, looks = FAR, NEAR, LOOKS

    def _look(self) -> None:
        """See the hole, and how the thread lies in the jaws."""
        look = self.observation
        self._hole = look.point("hole") + self._error
        self._axis = look.point("axis")
        X_WT = self.measured_tool(look.point("tip"))
        self._nodes_T = (look.point("nodes") - X_WT[:3, 3]) @ X_WT[:3, :3]

    def _thread(self, ahead: float) -> tuple[Array, Array]:
        """Point of the thread and its direction there, tool frame: ``ahead`` of its end [m].

        A negative number is a place on the thread.
        """
        back = max(-ahead, 0.0) / PIECE
        i = int(min(back, GRIP - 1))
        near, far = self._nodes_T[i], self._nodes_T[i + 1]
        d = (near - far) / np.linalg.norm(near - far)
        return near + (max(ahead, 0.0) - (back - i) * PIECE) * d, d

    def _target(self, ahead: float) -> tuple[Array, Array]:
        """Place of the tip [m] and roll [rad] (1,) with the thread's end ``ahead`` of the hole [m].

        Solved by fixed point: the shaft's direction hardly depends on the tip's place.
        """
        p_T, d_T = self._thread(ahead)
        p, roll = self.observation.point("tip"), np.array([self.me.roll])
        for _ in range(12):
            R = self.tool_pose(p, roll)[:3, :3]
            d, s = R @ d_T, R[:, 2]
            roll = roll + turn_onto(self._axis, d, s)
            p = self._hole - self.tool_pose(p, roll)[:3, :3] @ p_T
        return p, roll

    def _clear_way(self) -> Array:
        """The hole's axis."""
        return self._axis

    def _enter(self) -> Generator[None, None, bool]:
        """Push, and draw back what did not go through."""
        yield from self._push()
        if not self._through:
            yield from self._go(FAR, 0.5)
        return self._through

    def _push(self) -> Iterator[None]:
        """Push the thread through along its own curve; ``_through`` says whether it went."""
        self._look()
        self._through, pushed = False, 0.0
        end_T = self._nodes_T[0]
        while self.observation.number("depth") < ENOUGH:
            pushed += SPEED * STEP
            p, roll = self._target(NEAR - pushed)
            self._put(p, roll)
            yield
            unbent = p + self.tool_pose(p, roll)[:3, :3] @ end_T
            bent = float(np.linalg.norm(self.observation.point("end") - unbent))
            if bent > BENT or pushed > NEAR + MOST:
                return
        yield from self.wait(HOLD)
        self._through = self.observation.number("depth") > 0.0
