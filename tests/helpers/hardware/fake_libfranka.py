"""Modules in the place of pylibfranka and panda_py, around one made-up arm on a made-up clock.

Each state that is read is one millisecond. The arm follows velocities exactly, extrapolates what it
misses, and stops by a reflex at a jump in acceleration, as the maker documents it.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any

from surg_hardware.shaper import JointLimits

T = 0.001


class RobotMode(Enum):
    """libfranka's, by pylibfranka's names."""

    Other = 0
    Idle = 1
    Move = 2
    Guiding = 3
    Reflex = 4
    UserStopped = 5


class FrankaException(Exception):
    """Base of the library's exceptions."""


class ControlException(FrankaException):
    """A motion was aborted."""


class Duration:
    """A time that the library gives."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def to_sec(self) -> float:
        """In seconds."""
        return self._seconds


class JointVelocities:
    """A command."""

    def __init__(self, dq: Sequence[float]) -> None:
        self.dq, self.motion_finished = list(dq), False


class Arm:
    """The robot behind the library.

    Attributes:
        excess: Largest acceleration and jerk of the commands, as a share of the limits.
        ended: Speed at which the last motion was finished [rad/s].
        sluggish: Share of its last value in the acceleration that the arm reports; a real arm
            reports the newest one alone.
    """

    def __init__(self, limits: Sequence[JointLimits], q: Sequence[float]) -> None:
        self.limits = limits
        self.count = 0
        self.mode = RobotMode.Idle
        self.errors = types.SimpleNamespace()
        self.q, n = list(q), len(limits)
        self.dq_d, self.ddq_d = [0.0] * n, [0.0] * n
        self.excess = [0.0, 0.0]
        self.ended: float | None = None
        self.collision: tuple[Any, ...] = ()
        self.sluggish, self._reported = 0.0, [0.0] * n
        self.lose = 0  # commands that will be lost
        self.rate = 1.0
        self.on_cycle: Callable[[], None] = lambda: None

    def state(self) -> Any:
        """The next state, one millisecond later."""
        self.count += 1
        self.on_cycle()
        old, pairs = self.sluggish, zip(self._reported, self.ddq_d, strict=True)
        self._reported = [old * a + (1.0 - old) * b for a, b in pairs]
        return types.SimpleNamespace(
            time=Duration(T * self.count),
            robot_mode=self.mode,
            current_errors=self.errors,
            last_motion_errors=types.SimpleNamespace(),
            q=list(self.q),
            q_d=list(self.q),
            dq=list(self.dq_d),
            dq_d=list(self.dq_d),
            ddq_d=list(self._reported),
            O_F_ext_hat_K=[1.0, 2.0, 3.0, 0.1, 0.2, 0.3],
            O_T_EE=[0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0.3, 0.4, 0.5, 1],
            F_T_EE=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.0, 0.0, 0.1, 1],
            m_total=0.7,
            F_x_Ctotal=[0.0, 0.01, 0.03],
            control_command_success_rate=self.rate,
        )

    def take(self, command: JointVelocities) -> None:
        """A command of the motion."""
        if self.mode is not RobotMode.Move:
            raise ControlException("libfranka: motion aborted")
        if self.lose > 0:
            self.lose -= 1
            self._move([v + a * T for v, a in zip(self.dq_d, self.ddq_d, strict=True)])
            return
        for limit, v, before, a_before in zip(
            self.limits, command.dq, self.dq_d, self.ddq_d, strict=True
        ):
            a = (v - before) / T
            self.excess[0] = max(self.excess[0], abs(a) / limit.acceleration)
            self.excess[1] = max(self.excess[1], abs(a - a_before) / T / limit.jerk)
        if max(self.excess) > 1.0:
            self.reflex("joint_motion_generator_acceleration_discontinuity")
            raise ControlException("libfranka: motion aborted by reflex")
        self.ddq_d = [(v - b) / T for v, b in zip(command.dq, self.dq_d, strict=True)]
        self._move(command.dq)
        if command.motion_finished:
            self.ended = max(map(abs, self.dq_d))
            self.mode = RobotMode.Idle

    def reflex(self, error: str) -> None:
        """The robot stops by itself."""
        self.mode, self.errors = RobotMode.Reflex, types.SimpleNamespace(**{error: True})
        self.dq_d = self.ddq_d = [0.0] * len(self.limits)

    def recover(self) -> None:
        """As a person asks for it."""
        self.mode, self.errors = RobotMode.Idle, types.SimpleNamespace()

    def _move(self, velocities: Sequence[float]) -> None:
        self.q = [q + T * v for q, v in zip(self.q, velocities, strict=True)]
        self.dq_d = list(velocities)


def pylibfranka(arm: Arm) -> types.ModuleType:
    """The FR3's library."""

    class Control:
        def readOnce(self) -> tuple[Any, Duration]:
            if arm.mode is not RobotMode.Move:
                raise ControlException("libfranka: motion aborted")
            return arm.state(), Duration(T)

        def writeOnce(self, command: JointVelocities) -> None:
            arm.take(command)

    class Robot:
        def __init__(self, address: str, realtime: object) -> None:
            del address, realtime

        def read_once(self) -> Any:
            return arm.state()

        def set_collision_behavior(self, *thresholds: Any) -> None:
            arm.collision = thresholds

        def automatic_error_recovery(self) -> None:
            arm.recover()

        def start_joint_velocity_control(self, mode: object) -> Control:
            if arm.mode is not RobotMode.Idle:
                raise FrankaException(f"libfranka: Move command rejected in {arm.mode.name}")
            arm.mode = RobotMode.Move
            return Control()

    module = types.ModuleType("pylibfranka")
    module.__dict__.update(
        Robot=Robot,
        JointVelocities=JointVelocities,
        FrankaException=FrankaException,
        ControlException=ControlException,
        RealtimeConfig=types.SimpleNamespace(kIgnore=1),
        ControllerMode=types.SimpleNamespace(JointImpedance=0),
    )
    return module


def panda_py(arm: Arm) -> types.ModuleType:
    """The Panda's library: one callback per millisecond."""

    class Robot:
        def __init__(self, address: str, realtime: object) -> None:
            del address, realtime

        def read_once(self) -> Any:
            return arm.state()

        def set_collision_behavior(self, *thresholds: Any) -> None:
            arm.collision = thresholds

        def automatic_error_recovery(self) -> None:
            arm.recover()

        def control_joint_velocity(
            self, answer: Callable[[Any, Any], JointVelocities], *options: object
        ) -> None:
            assert options[1:] == (False, 1000.0), "the library's own limits and filter are off"
            arm.mode = RobotMode.Move
            try:
                while arm.mode is RobotMode.Move:
                    arm.take(answer(arm.state(), Duration(T)))
                if arm.ended is None:
                    raise ControlException("libfranka: motion aborted")
            except ControlException as error:
                raise RuntimeError(str(error)) from error

    inner = types.ModuleType("panda_py.libfranka")
    inner.__dict__.update(
        Robot=Robot,
        JointVelocities=JointVelocities,
        RealtimeConfig=types.SimpleNamespace(kIgnore=1),
        ControllerMode=types.SimpleNamespace(kJointImpedance=0),
    )
    module = types.ModuleType("panda_py")
    module.__dict__.update(libfranka=inner)
    return module
