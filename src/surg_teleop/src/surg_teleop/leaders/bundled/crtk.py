"""A CRTK leader on topics, such as a browser, gamepad or haptic device in its own process.

Pure; ``crtk_leader_node`` subscribes. ``now`` is a message's receipt on the steady clock [s],
corrected for network delays (:class:`~surg_core.hand.message_lateness.Arrivals`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from surg_core import matrix_to_quaternion_xyzw, rpy_to_matrix
from surg_core.arm_view import Array
from surg_core.hand.leader_sample import HandlePose, HandRate, LeaderSample
from surg_core.transforms import multiply_quaternions

FRESH = 0.1
"""[s] Largest difference between pose and velocity of one sample."""


class CrtkLeader:
    """A leader that is a process of its own.

    Args:
        name: Its namespace, without slashes, ``MTMR`` for example.
        rotation: (3,) roll, pitch, yaw of its axes in the view frame V [rad].
        grip_closed: Its gripper's position when closed [rad].
        grip_open: The same when open; the smaller one if closing counts upwards.
    """

    def __init__(
        self,
        name: str = "leader",
        rotation: ArrayLike = (0.0, 0.0, 0.0),
        grip_closed: float = 0.0,
        grip_open: float = 1.0,
    ) -> None:
        self.name = name.strip("/")
        if not self.name:
            raise ValueError("name: is empty; allowed: the leader's namespace")
        if not abs(grip_open - grip_closed) > 1e-6:
            raise ValueError("grip_closed and grip_open are the same; allowed: two different ones")
        self._R_VL = rpy_to_matrix(rotation)
        self._q_VL = matrix_to_quaternion_xyzw(self._R_VL)
        self._grip_range = (grip_closed, grip_open)
        self.open()

    def open(self) -> None:
        """Forget all messages."""
        self._pose: tuple[float, HandlePose] | None = None
        self._rate: tuple[float, HandRate] | None = None
        self._grip: float | None = None
        self._heard = self._grip_at = -math.inf
        self._late: tuple[float, float] | None = None
        self._state = "ENABLED"  # a leader without operating_state is taken as it is

    close = open

    def on_pose(self, now: float, p: Array, q: Array) -> None:
        """``measured_cp``: p (3,) [m], q (4,) x, y, z, w; in the leader's axes."""
        self._note_message(now)
        # An invalid orientation is passed on, so that the teleoperation reports it and stops.
        length = float(np.linalg.norm(q))
        q_LH = q / length if abs(length - 1.0) < 1e-2 else np.full(4, np.nan)
        self._pose = now, HandlePose(self._R_VL @ p, multiply_quaternions(self._q_VL, q_LH))

    def on_rate(self, now: float, v: Array, w: Array) -> None:
        """``measured_cv``: wanted v (3,) of the tip [m/s] in the leader's axes, w (3,) [rad/s].

        The part of w along the view's z is the roll; the others tilt a wrist.
        """
        self._note_message(now)
        omega = self._R_VL @ w
        self._rate = now, HandRate(self._R_VL @ v, float(omega[2]), tilt=omega[:2])

    def on_spherical(self, now: float, rates: Array) -> None:
        """``spherical/measured_js``: wanted rates (4,) of yaw, pitch, insertion, roll, SI."""
        self._note_message(now)
        self._rate = now, HandRate(np.zeros(3), float(rates[3]), np.array(rates[:3]))

    def on_late(self, now: float, by: float) -> None:
        """A message received now was delayed by so many seconds."""
        self._late = now, by

    def on_grip(self, now: float, position: float) -> None:
        """``gripper/measured_js`` [rad]."""
        self._grip_at = now
        closed, opened = self._grip_range
        self._grip = min(max((position - closed) / (opened - closed), 0.0), 1.0)
        if not math.isfinite(position):
            self._grip = math.nan

    def _note_message(self, now: float) -> None:
        """Forget the grip after a silence: the hand may be another operator's.

        Without a silence the grip stays, because some devices send it on changes only.
        """
        if now - max(self._heard, self._grip_at) > FRESH:
            self._grip = None
        self._heard = now

    def on_state(self, state: str) -> None:
        """``operating_state``."""
        self._state = state

    def read(self, now: float) -> LeaderSample | None:
        """The newest values; None before the first pose or velocity."""
        parts = [part for part in (self._pose, self._rate) if part is not None]
        if not parts:
            return None
        stamp = max(part[0] for part in parts)
        problem = ""
        if self._late is not None and now - self._late[0] <= FRESH:
            problem = (
                f"its messages come {self._late[1]:.1f} s late: look at the network and at its "
                "clock, then press the clutch or enable"
            )
        if self._state != "ENABLED":
            problem = f"is {self._state}: enable it, then press the clutch or enable"
        return LeaderSample(
            stamp=stamp,
            pose=self._pose[1] if self._pose and stamp - self._pose[0] <= FRESH else None,
            rate=self._rate[1] if self._rate and stamp - self._rate[0] <= FRESH else None,
            grip=self._grip,
            problem=problem,
        )
