"""Motion of an emulated UR arm: from a motion command to joint positions, one cycle at a time.

The target follows the command at once, as the controller of the arm computes it. The joints follow
the target with a first-order lag, each with its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

DT = 0.002
"""Cycle of an e-Series controller [s]."""
LAGS = (0.0050, 0.0062, 0.0056, 0.0074, 0.0085, 0.0068)
"""Lag of each joint behind its target [s]. Assumed: no arm has been measured."""
MAX_SPEED = 3.2
"""Above it a joint causes a protective stop [rad/s]; the data sheet's limit is 3.1416."""
MAX_ACCELERATION = 45.0
"""Above it a joint's target causes a protective stop [rad/s^2]. Assumed: clients may ask for 40."""
MAX_POSITION = 2.0 * math.pi + 0.05
"""Beyond it a joint causes a protective stop [rad]; the data sheet's range is one turn."""
BRAKING = 10.0
"""Deceleration of the leading axis in every stop that no program commands [rad/s^2]. Assumed."""
SOFT = 0.85
"""Share of its acceleration with which a move brakes."""
FASTEST, SHARPEST = 3.1, 20.0
"""A move to a goal keeps its joints to this speed [rad/s] and acceleration [rad/s^2]. Assumed."""
TURNING = 20.0
"""Acceleration of the leading axis between two moves with a blend [rad/s^2]. Assumed."""
AT_REST = 1e-4
"""A joint below this speed stands still [rad/s]."""

Vector = list[float]


def leading(vector: Sequence[float]) -> float:
    """Largest magnitude in a vector."""
    return max(abs(value) for value in vector)


@dataclass(frozen=True)
class Speed:
    """Accelerate to joint velocities and keep them until another command comes (`speedj`).

    Attributes:
        qd: Joint velocities [rad/s], 6.
        a: Acceleration of the leading axis [rad/s^2].
    """

    qd: Sequence[float]
    a: float

    def velocity(self, q: Vector, qd: Vector, dt: float) -> Vector:
        """Target velocity after `dt`, along the straight line to the wanted one."""
        change = [wanted - now for wanted, now in zip(self.qd, qd, strict=True)]
        largest = leading(change)
        share = min(1.0, self.a * dt / largest) if largest > 0.0 else 1.0
        return [now + share * step for now, step in zip(qd, change, strict=True)]


def approach(distance: float, speed: float, a: float, v: float, dt: float) -> float:
    """The speed after `dt` on the way to a goal.

    It is the largest from which braking in steps of dt still ends there. It brakes softer than
    `a`, so that the last cycle, in which it has to hit the goal, keeps to `a`.

    Args:
        distance: That is left [m or rad]; likewise the other units.
        speed: Now.
        a: Acceleration.
        v: Largest speed.
        dt: Time [s].
    """
    soft = SOFT * a
    braking = soft * (math.sqrt(dt * dt / 4.0 + 2.0 * distance / soft) - dt / 2.0)
    return min(v, speed + a * dt, braking, distance / dt)


def timed(distance: float, seconds: float) -> tuple[float, float]:
    """Acceleration and speed with which `approach` takes a way within a time.

    The speed is 1.5 times the mean one; the accelerations follow from the area below its trapezoid.
    """
    return (
        2.25 * (1.0 + 1.0 / SOFT) * distance / seconds**2,
        1.5 * distance / seconds,
    )


def turned(wanted: Sequence[float], qd: Vector, dt: float) -> Vector:
    """Joint velocities of a move that follows a blend: it turns into its way as fast as it may."""
    return Speed(wanted, TURNING).velocity(list(wanted), qd, dt)


@dataclass(frozen=True)
class Move:
    """Go to joint positions in a straight line of joint space (`movej`).

    Attributes:
        q: Goal [rad], 6.
        a: Acceleration of the leading axis [rad/s^2].
        v: Velocity of the leading axis [rad/s].
        turns: Whether the arm still moves from the move before.
    """

    q: Sequence[float]
    a: float
    v: float
    turns: bool = False

    def velocity(self, q: Vector, qd: Vector, dt: float) -> Vector:
        """Target velocity after `dt`; zero within one step of the goal."""
        way = [goal - now for goal, now in zip(self.q, q, strict=True)]
        distance = leading(way)
        if distance < 1e-9:
            return [0.0] * 6
        a, v = min(self.a, SHARPEST), min(self.v, FASTEST)
        speed = approach(distance, leading(qd), a, v, dt)
        wanted = [speed * each / distance for each in way]
        return turned(wanted, qd, dt) if self.turns else wanted


@dataclass(frozen=True)
class Servo:
    """Follow a position with a low-pass of the look-ahead time (`servoj`).

    Attributes:
        q: Goal [rad], 6.
        lookahead: Time constant [s].
    """

    q: Sequence[float]
    lookahead: float

    def velocity(self, q: Vector, qd: Vector, dt: float) -> Vector:
        """Target velocity after `dt`."""
        step = 1.0 - math.exp(-dt / self.lookahead)
        return [(goal - now) * step / dt for goal, now in zip(self.q, q, strict=True)]


class Command(Protocol):
    """What the target follows."""

    def velocity(self, q: Vector, qd: Vector, dt: float) -> Vector:
        """Target velocity [rad/s] after `dt` [s], of target position [rad] and velocity [rad/s]."""


REST = Speed((0.0,) * 6, BRAKING)


@dataclass
class JointMotion:
    """Target and actual motion of six joints.

    Attributes:
        q: Target positions [rad].
        command: What the target follows.
        scale: Time scaling of the trajectory, 0 to 1 (speed slider, pause).
        lags: Lag of each joint [s].
        qd: Target velocities [rad/s], scaled.
        qdd: Target accelerations [rad/s^2].
        actual_q: Positions of the joints [rad].
        actual_qd: Velocities of the joints [rad/s].
    """

    q: Vector
    command: Command = REST
    scale: float = 1.0
    lags: Sequence[float] = LAGS
    qd: Vector = field(default_factory=lambda: [0.0] * 6)
    qdd: Vector = field(default_factory=lambda: [0.0] * 6)
    actual_q: Vector = field(default_factory=list)
    actual_qd: Vector = field(default_factory=lambda: [0.0] * 6)
    _unscaled: Vector = field(default_factory=lambda: [0.0] * 6)

    def __post_init__(self) -> None:
        self.actual_q = list(self.q)
        self._follow = [1.0 - math.exp(-DT / lag) for lag in self.lags]

    @property
    def at_rest(self) -> bool:
        """Whether target and joints stand still."""
        return leading(self.qd) < AT_REST and leading(self.actual_qd) < AT_REST

    def brake(self) -> None:
        """Stop along the straight line in joint space; the time scaling no longer counts."""
        self.command, self.scale, self._unscaled = REST, 1.0, list(self.qd)

    def step(self) -> str:
        """One cycle. Returns why the arm must stop, or an empty text.

        A step that breaks a limit is not executed: the caller brakes instead.
        """
        unscaled = self.command.velocity(self.q, self._unscaled, DT * max(self.scale, 1e-9))
        qd = [self.scale * value for value in unscaled]
        qdd = [(new - old) / DT for new, old in zip(qd, self.qd, strict=True)]
        broken = "" if self.command is REST else self._broken_limit(qd, qdd)
        if not broken:
            self._unscaled = unscaled
            self._execute(qd, qdd)
        return broken

    def drag(self, qd: Sequence[float]) -> None:
        """One cycle in which a hand moves the joints [rad/s]; the target goes with them."""
        self.command, self._unscaled = REST, [0.0] * 6
        self.q = [now + DT * rate for now, rate in zip(self.actual_q, qd, strict=True)]
        self.qd, self.qdd = [0.0] * 6, [0.0] * 6
        self.actual_q, self.actual_qd = list(self.q), list(qd)

    def lock(self) -> None:
        """One cycle with the brakes on."""
        self.command, self._unscaled = REST, [0.0] * 6
        self.q, self.qd, self.qdd = list(self.actual_q), [0.0] * 6, [0.0] * 6
        self.actual_qd = [0.0] * 6

    def _broken_limit(self, qd: Vector, qdd: Vector) -> str:
        for joint in range(6):
            where = f"joint {joint + 1}:"
            if not abs(qd[joint]) <= MAX_SPEED:
                return f"{where} speed {qd[joint]:.2f} rad/s, allowed {MAX_SPEED}"
            if not abs(qdd[joint]) <= MAX_ACCELERATION:
                return f"{where} acceleration {qdd[joint]:.0f} rad/s^2, allowed {MAX_ACCELERATION}"
            if not abs(self.q[joint] + DT * qd[joint]) <= MAX_POSITION:
                return f"{where} position {self.q[joint]:.2f} rad, allowed {MAX_POSITION:.2f}"
        return ""

    def _execute(self, qd: Vector, qdd: Vector) -> None:
        self.qd, self.qdd = qd, qdd
        self.q = [now + DT * rate for now, rate in zip(self.q, qd, strict=True)]
        for joint, goal in enumerate(self.q):
            step = self._follow[joint] * (goal - self.actual_q[joint])
            self.actual_q[joint] += step
            self.actual_qd[joint] = step / DT
