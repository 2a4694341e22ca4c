"""Motion of an emulated Franka arm, one cycle at a time: generator, its limits, lag of the joints.

The generator's set-point follows the commands without delay. The joints follow the set-point with a
first-order lag, which grows as the impedance falls. A lost packet continues the last acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from surg_emulators.franka.franka_errors import Error, Violation
from surg_emulators.franka.franka_robots import FrankaRobot

DT = 0.001
"""Cycle of the research interface [s]."""
LAGS = (0.0040, 0.0046, 0.0042, 0.0050, 0.0036, 0.0038, 0.0034)
"""Lag of each joint behind its set-point at the default impedance [s]. Assumed."""
STIFFNESS = (3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0)
"""Default joint impedance [Nm/rad] (Franka's documentation)."""
START_WINDOW = 1e-4
"""A first commanded position further from the set-point is refused [rad]. Assumed."""
BRAKING = 0.9
"""Share of the acceleration limits with which every stop brakes. Assumed."""
AT_REST = 1e-4
"""A joint below this speed stands still [rad/s]."""
SLACK = 1.0 + 1e-9
Vector = list[float]


@dataclass
class GeneratorMotion:
    """Set-point and measured motion of seven joints.

    Attributes:
        robot: Limits.
        q_d: Positions of the set-point [rad].
        dq_d: Velocities of the set-point [rad/s].
        ddq_d: Accelerations of the set-point [rad/s^2].
        q: Positions of the joints [rad].
        dq: Velocities of the joints [rad/s].
    """

    robot: FrankaRobot
    q_d: Vector
    dq_d: Vector = field(default_factory=lambda: [0.0] * 7)
    ddq_d: Vector = field(default_factory=lambda: [0.0] * 7)
    q: Vector = field(default_factory=list)
    dq: Vector = field(default_factory=lambda: [0.0] * 7)

    def __post_init__(self) -> None:
        self.q = list(self.q_d)
        self.set_stiffness(STIFFNESS)

    def set_stiffness(self, stiffness: Sequence[float]) -> None:
        """Joint impedance [Nm/rad], 7: a softer joint lags more."""
        self._follow = [
            1.0 - math.exp(-DT * max(new, 1.0) / (lag * usual))
            for new, lag, usual in zip(stiffness, LAGS, STIFFNESS, strict=True)
        ]

    @property
    def at_rest(self) -> bool:
        """Whether set-point and joints stand still."""
        return all(abs(rate) < AT_REST for rate in (*self.dq_d, *self.dq))

    def velocity_command(self, dq: Sequence[float]) -> None:
        """One cycle with commanded joint velocities [rad/s], 7.

        Raises:
            Violation: They break a limit; the cycle has not been executed.
        """
        self._check(dq)
        self._execute(dq)

    def position_command(self, q: Sequence[float], first: bool) -> None:
        """One cycle with commanded joint positions [rad], 7.

        Args:
            q: The positions.
            first: Whether the motion begins with them.

        Raises:
            Violation: They break a limit; the cycle has not been executed.
        """
        away = max(abs(new - old) for new, old in zip(q, self.q_d, strict=True))
        if first and not away <= START_WINDOW:
            raise Violation(
                Error.joint_position_motion_generator_start_pose_invalid,
                f"the first position is {away:.4f} rad from q_d, allowed {START_WINDOW} rad",
            )
        self.velocity_command([(new - old) / DT for new, old in zip(q, self.q_d, strict=True)])

    def lost_packet(self) -> None:
        """One cycle without a command: the acceleration stays.

        Raises:
            Violation: The motion reaches a limit of position or velocity.
        """
        dq = [rate + DT * change for rate, change in zip(self.dq_d, self.ddq_d, strict=True)]
        self._check_range(dq)
        self._execute(dq)

    def end(self) -> None:
        """The client says that its motion has ended: the arm must be at rest.

        Raises:
            Violation: The step to rest breaks the limit of acceleration or of jerk.
        """
        self._check([0.0] * 7)

    def brake(self) -> None:
        """One cycle of a stop along the straight line in joint space."""
        share = 1.0
        for rate, most in zip(self.dq_d, self.robot.acceleration, strict=True):
            if rate:
                share = min(share, BRAKING * most * DT / abs(rate))
        self._execute([rate - share * rate for rate in self.dq_d])

    def drag(self, dq: Sequence[float]) -> None:
        """One cycle in which a hand moves the joints [rad/s] within their limits of position.

        The set-point goes with them.
        """
        before, robot = self.q, self.robot
        self.q = [
            min(max(now + DT * rate, low), high)
            for now, rate, low, high in zip(
                before, dq, robot.position_min, robot.position_max, strict=True
            )
        ]
        self.dq = [(new - old) / DT for new, old in zip(self.q, before, strict=True)]
        self.q_d, self.dq_d, self.ddq_d = list(self.q), [0.0] * 7, [0.0] * 7

    def lock(self) -> None:
        """One cycle with the brakes on."""
        self.q_d, self.dq = list(self.q), [0.0] * 7
        self.dq_d, self.ddq_d = [0.0] * 7, [0.0] * 7

    def _check(self, dq: Sequence[float]) -> None:
        self._check_range(dq)
        robot, rounding = self.robot, self.robot.rounding
        for joint in range(7):
            where = f"joint {joint + 1}:"
            ddq = (dq[joint] - self.dq_d[joint]) / DT
            most = robot.acceleration[joint]
            if not abs(ddq) <= most * SLACK + 2.0 * rounding / DT:
                raise Violation(
                    Error.joint_motion_generator_velocity_discontinuity,
                    f"{where} acceleration {ddq:.2f} rad/s^2, allowed {most}",
                )
            jerk = (ddq - self.ddq_d[joint]) / DT
            most = robot.jerk[joint]
            if not abs(jerk) <= most * SLACK + 4.0 * rounding / DT**2:
                raise Violation(
                    Error.joint_motion_generator_acceleration_discontinuity,
                    f"{where} jerk {jerk:.0f} rad/s^3, allowed {most:.0f}",
                )

    def _check_range(self, dq: Sequence[float]) -> None:
        robot = self.robot
        for joint in range(7):
            where = f"joint {joint + 1}:"
            low, high = robot.velocity_range(joint, self.q_d[joint])
            if not low * SLACK - robot.rounding <= dq[joint] <= high * SLACK + robot.rounding:
                raise Violation(
                    Error.joint_motion_generator_velocity_limits_violation,
                    f"{where} velocity {dq[joint]:.3f} rad/s, allowed {low:.3f} to {high:.3f}",
                )
            q = self.q_d[joint] + DT * dq[joint]
            low, high = robot.position_min[joint], robot.position_max[joint]
            if not low <= q <= high:
                raise Violation(
                    Error.joint_motion_generator_position_limits_violation,
                    f"{where} position {q:.4f} rad, allowed {low} to {high}",
                )

    def _execute(self, dq: Sequence[float]) -> None:
        self.ddq_d = [(new - old) / DT for new, old in zip(dq, self.dq_d, strict=True)]
        self.dq_d = list(dq)
        self.q_d = [now + DT * rate for now, rate in zip(self.q_d, dq, strict=True)]
        self.settle()

    def settle(self) -> None:
        """Let the joints follow the set-point for one cycle."""
        for joint, goal in enumerate(self.q_d):
            step = self._follow[joint] * (goal - self.q[joint])
            self.q[joint] += step
            self.dq[joint] = step / DT
