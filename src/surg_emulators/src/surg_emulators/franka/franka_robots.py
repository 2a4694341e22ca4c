"""The two Franka arms that are emulated: protocol, limits and impedance of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

HOME = (0.0, -math.pi / 4.0, 0.0, -3.0 * math.pi / 4.0, 0.0, math.pi / 2.0, math.pi / 4.0)


@dataclass(frozen=True)
class VelocityCurve:
    """A joint's velocity limits, which fall towards its position limits.

    The upper limit is `-offset + sqrt(fall * (upper - q))`, the lower one mirrored.

    Attributes:
        offset: Velocity that is kept in reserve [rad/s].
        fall: Twice the deceleration towards the limit [rad/s^2].
        lower: Lower zero of the square root [rad].
        upper: Upper zero of the square root [rad].
    """

    offset: float
    fall: float
    lower: float
    upper: float


@dataclass(frozen=True)
class FrankaRobot:
    """One kind of arm.

    Attributes:
        name: As on the command line.
        title: For people.
        version: Of the research interface.
        library: libfranka's versions that speak it, for people.
        position_min: Of each joint [rad].
        position_max: Of each joint [rad].
        velocity: Largest magnitude of each joint [rad/s].
        acceleration: Largest magnitude of each joint [rad/s^2].
        jerk: Largest magnitude of each joint [rad/s^3].
        curves: Velocity limits by position; none where they do not depend on it.
        rounding: Of velocities in the state, which a client continues from [rad/s].
    """

    name: str
    title: str
    version: int
    library: str
    position_min: Sequence[float]
    position_max: Sequence[float]
    velocity: Sequence[float]
    acceleration: Sequence[float]
    jerk: Sequence[float]
    curves: Sequence[VelocityCurve]
    rounding: float

    def velocity_range(self, joint: int, q: float) -> tuple[float, float]:
        """Lowest and highest velocity of a joint at a position [rad/s]."""
        most = self.velocity[joint]
        if not self.curves:
            return -most, most
        curve = self.curves[joint]
        up = math.sqrt(max(0.0, curve.fall * (curve.upper - q))) - curve.offset
        down = curve.offset - math.sqrt(max(0.0, curve.fall * (q - curve.lower)))
        return max(-most, min(0.0, down)), min(most, max(0.0, up))


FER = FrankaRobot(
    name="fer",
    title="Franka Emika Robot (Panda)",
    version=5,
    library="0.9.x",
    position_min=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    position_max=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    velocity=(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
    acceleration=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
    jerk=(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    curves=(),
    rounding=1e-12,
)
FR3 = FrankaRobot(
    name="fr3",
    title="Franka Research 3",
    version=10,
    library="0.21",
    position_min=(-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159),
    position_max=(2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159),
    velocity=(2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
    acceleration=(10.0,) * 7,
    jerk=(5000.0,) * 7,
    curves=(
        VelocityCurve(0.30, 12.0, -2.75010, 2.75010),
        VelocityCurve(0.20, 5.17, -1.79180, 1.79180),
        VelocityCurve(0.20, 7.0, -2.90650, 2.90650),
        VelocityCurve(0.30, 8.0, -3.04810, -0.14580),
        VelocityCurve(0.35, 34.0, -2.81010, 2.81010),
        VelocityCurve(0.35, 11.0, 0.54092, 4.52050),
        VelocityCurve(0.35, 34.0, -3.01960, 3.01960),
    ),
    rounding=2.5e-7,
)
ROBOTS = {robot.name: robot for robot in (FER, FR3)}
"""Source of all limits: Franka's FCI documentation, robot and interface specifications."""
