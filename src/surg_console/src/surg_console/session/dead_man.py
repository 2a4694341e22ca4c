"""The dead-man of a headset's controllers: nothing of a hand goes on unless its squeeze is held.

The handle that goes out is the sum of what the hand did while it was squeezed. It stands still
otherwise, so a clutch that reaches the teleoperation late, or never, moves nothing either.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from surg_console.web.page_protocol import Input
from surg_core.arm_view import Array
from surg_core.transforms import CONJUGATE, multiply_quaternions

SETTLE = 0.1
"""[s] Between closing the clutch and moving the camera pedal, between that and opening the clutch,
and from there until motion counts. Each travels on a topic of its own, and must be there first: a
pedal that overtakes a motion would turn it over to the other arm."""


class DeadMan:
    """One page's hands. A lost controller, or `reset`, needs a squeeze that is let go first."""

    def __init__(self) -> None:
        self.engaged = False
        """Whether a squeeze is held that counts."""
        self._armed = False
        self._clutched, self._since = True, -math.inf  # and since when [s]
        self._camera, self._camera_since = False, -math.inf
        self._p, self._q = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
        self._last: tuple[Array, Array] | None = None
        self._grip: float | None = None

    def reset(self) -> None:
        """Nothing goes on until all squeezes have been let go and one is held again."""
        self.engaged = self._armed = False
        self._clutched, self._since = True, -math.inf
        self._camera, self._camera_since = False, -math.inf
        self._last = None

    def pass_on(self, sample: Input, now: float) -> Input:
        """What goes out for an input of the page at a time [s]."""
        squeezed = sample.squeeze is True
        self._armed = sample.tracked and (self._armed or not squeezed)
        self.engaged = squeezed and self._armed
        self._move_pedals(sample.camera, now)
        settled = now - self._since >= SETTLE
        counts = settled and not self._clutched and not sample.clutch
        if counts:
            self._add(np.array(sample.p), np.array(sample.q))
        else:
            self._last = None
        if settled or not self._clutched:
            self._grip = sample.grip
        x, y, z = self._p.tolist()
        qx, qy, qz, qw = self._q.tolist()
        return replace(
            sample,
            hand="position",
            p=(x, y, z),
            q=(qx, qy, qz, qw),
            v=(0.0, 0.0, 0.0),
            roll_rate=0.0,
            tilt=(0.0, 0.0),
            grip=self._grip,
            clutch=sample.clutch or self._clutched,
            camera=self._camera,
        )

    def _move_pedals(self, camera: bool, now: float) -> None:
        """The clutch opens for the hand that is squeezed; the camera pedal moves under it."""
        other = self.engaged and camera != self._camera
        if other and self._clutched and now - self._since >= SETTLE:
            self._camera, self._camera_since, other = camera, now, False
        open_ = self.engaged and not other and now - self._camera_since >= SETTLE
        if open_ == self._clutched:
            self._clutched, self._since = not open_, now

    def _add(self, p: Array, q: Array) -> None:
        """Add the hand's motion since the last input: its way, and its turn in its own axes."""
        q = q / np.linalg.norm(q)
        if self._last is not None:
            last_p, last_q = self._last
            self._p = self._p + p - last_p
            turn = multiply_quaternions(last_q * CONJUGATE, q)
            turned = multiply_quaternions(self._q, turn)
            self._q = turned / np.linalg.norm(turned)
        self._last = p, q
