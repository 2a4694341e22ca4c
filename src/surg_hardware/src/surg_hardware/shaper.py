"""Joint velocities for a robot that refuses jumps in velocity, acceleration and jerk.

Pure. The controller commands joint velocities every 2 ms, a staircase with jumps in acceleration.
A Franka takes one velocity per millisecond and stops with a reflex at such a jump. The shaper
interpolates the commands and keeps to the limits. It starts every millisecond from the robot's own
desired velocity and acceleration: a robot that misses a command extrapolates, and a shaper that
relied on its own memory would then command a jump.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

ACCELERATION_SHARE = 0.95
"""Of the published limit: the robot computes in single precision and extrapolates after a loss."""
JERK_SHARE = 0.8
"""Of the published limit: a lost command adds a jump of its own."""
BRAKING_SHARE = 0.6
"""Of the acceleration, in which a joint can stop before the end of its range."""
COMMAND_PERIOD = 0.002
"""[s] Of the controller's commands."""


@dataclass(frozen=True)
class JointLimits:
    """What the maker publishes for one joint.

    The velocity limit falls towards both ends of the range: at a distance d from the end
    ``-offset + sqrt(slope * d)``. A slope of zero means that it does not depend on the posture.
    """

    velocity: float  # [rad/s]
    acceleration: float  # [rad/s^2]
    jerk: float  # [rad/s^3]
    lower: float  # [rad] where the formula's d is zero
    upper: float  # [rad]
    offset: float = 0.0  # [rad/s]
    slope: float = 0.0  # [rad/s^2]


class _JointShaper:
    """One joint. A and J are the acceleration and jerk that it uses."""

    def __init__(self, limits: JointLimits, cycle: float) -> None:
        self._T = cycle
        self._A = ACCELERATION_SHARE * limits.acceleration
        self._JT = JERK_SHARE * limits.jerk * cycle
        # The joint stops at the end of its range, and where the published limit reaches zero.
        braking = 2.0 * BRAKING_SHARE * self._A
        self._slope = min(limits.slope, braking) if limits.slope else braking
        self._offset = limits.offset or 0.2
        unusable = limits.offset**2 / limits.slope if limits.slope else 0.0
        self._lower, self._upper = limits.lower + unusable, limits.upper - unusable
        # The velocity runs over its bound by this much while the acceleration turns round.
        J = self._JT / cycle
        self._overshoot = (self._A + 0.5 * self._slope) ** 2 / (2.0 * J)
        self._fastest = limits.velocity - self._JT * cycle

    def bound(self, distance: float) -> float:
        """The velocity [rad/s] from which the joint stops within a distance [rad]."""
        if distance <= 0.0:
            return 0.0
        root = math.sqrt(self._offset * self._offset + self._slope * distance)
        return min(self._fastest, max(0.0, root - self._offset - self._overshoot))

    def next(self, wanted: float, q: float, dq_d: float, ddq_d: float) -> float:
        """The velocity of the next cycle [rad/s], on the way to the wanted one."""
        wanted = min(wanted, self.bound(self._upper - q))
        wanted = max(wanted, -self.bound(q - self._lower))
        away = wanted - dq_d
        JT, T = self._JT, self._T
        # The largest acceleration that can still be taken back before the velocity is reached.
        largest = 0.5 * JT * (math.sqrt(1.0 + 8.0 * abs(away) / (JT * T)) - 1.0)
        acceleration = math.copysign(min(self._A, largest, abs(away) / T), away)
        acceleration = min(max(acceleration, ddq_d - JT), ddq_d + JT)
        # After a loss the robot may be beyond the share that is used, never beyond its own limit.
        acceleration = min(max(acceleration, -self._A), self._A)
        return dq_d + acceleration * T


class Shaper:
    """Shapes the commands for one arm.

    Args:
        limits: Of each joint, in the arm's order.
        cycle: Of the robot [s].
    """

    def __init__(self, limits: Sequence[JointLimits], cycle: float = 0.001) -> None:
        self._joints = [_JointShaper(each, cycle) for each in limits]
        self._cycles = max(1, round(COMMAND_PERIOD / cycle))
        self._left = 0
        self._wanted = self._target = (0.0,) * len(limits)

    def shape(
        self,
        wanted: Sequence[float],
        q: Sequence[float],
        dq_d: Sequence[float],
        ddq_d: Sequence[float],
    ) -> tuple[float, ...]:
        """The velocities of one cycle [rad/s].

        Args:
            wanted: The newest command [rad/s].
            q: Measured positions [rad].
            dq_d: The robot's own desired velocities [rad/s].
            ddq_d: The robot's own desired accelerations [rad/s^2].
        """
        wanted = tuple(wanted)
        if wanted != self._wanted:
            self._wanted, self._left = wanted, self._cycles
        if self._left:
            share = 1.0 / self._left
            pairs = zip(self._target, wanted, strict=True)
            self._target = tuple(a + share * (b - a) for a, b in pairs)
            self._left -= 1
        values = zip(self._joints, self._target, q, dq_d, ddq_d, strict=True)
        return tuple(joint.next(u, p, v, a) for joint, u, p, v, a in values)
