"""Modules in the place of pylibfranka and panda_py, around an emulated arm on a made-up clock.

Each state that is read is one millisecond of the emulator's core.
"""

from __future__ import annotations

import random
import struct
import types
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from helpers.hardware.emulated_franka import Client
from surg_emulators.franka.franka_controller import FrankaController, RobotMode
from surg_emulators.franka.franka_kinematics import flange, from_columns, to_columns
from surg_emulators.franka.franka_robots import FrankaRobot
from surg_emulators.franka.generator_motion import DT


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
        lose: Commands that will be lost.
        loss: Share of the commands that are lost.
        rate: Share of the commands in time that the arm reports; None: the true one.
    """

    def __init__(self, robot: FrankaRobot, q: Sequence[float]) -> None:
        self.core = FrankaController(robot, q=q)
        self.client = Client(self.core)
        assert self.client.connect() == "success"
        self.excess = [0.0, 0.0]
        self.ended: float | None = None
        self.collision: tuple[Any, ...] = ()
        self.sluggish, self._reported = 0.0, np.zeros(7)
        self.lose, self.loss, self._random = 0, 0.0, random.Random(1)
        self.rate: float | None = None
        self._read = 0  # number of the state that was read last

    @property
    def count(self) -> int:
        """Milliseconds so far."""
        return self.core.number

    @property
    def dq_d(self) -> list[float]:
        """Of the set-point [rad/s]."""
        return self.core.motion.dq_d

    def state(self) -> Any:
        """The next state, one millisecond later."""
        self.client.wait(1)
        core, motion = self.core, self.core.motion
        self._read = core.number
        self._reported += (1.0 - self.sluggish) * (np.array(motion.ddq_d) - self._reported)
        errors = types.SimpleNamespace(
            **{error.name: True for error in core.errors | core.reflex_reason}
        )
        F_T_EE = from_columns(core.NE_T_EE)
        return types.SimpleNamespace(
            time=Duration(DT * core.number),
            robot_mode=types.SimpleNamespace(name=core.mode.name.title().replace("_", "")),
            current_errors=errors,
            last_motion_errors=errors,
            q=list(motion.q),
            q_d=list(motion.q_d),
            dq=list(motion.dq),
            dq_d=list(motion.dq_d),
            ddq_d=self._reported.tolist(),
            O_F_ext_hat_K=list(core.wrench),
            O_T_EE=to_columns(flange(motion.q) @ F_T_EE),
            F_T_EE=list(core.NE_T_EE),
            m_total=core.load[0],
            F_x_Ctotal=core.load[1:4],
            control_command_success_rate=core.success_rate if self.rate is None else self.rate,
        )

    def move(self) -> bool:
        """Begin a motion by velocities; whether the arm does."""
        return self.client.move() == "started"

    def take(self, command: JointVelocities) -> None:
        """A command of the motion."""
        motion, robot = self.core.motion, self.core.robot
        if self.core.mode is not RobotMode.MOVE:
            raise ControlException("libfranka: motion aborted")
        if self.lose > 0 or self._random.random() < self.loss:
            self.lose = max(0, self.lose - 1)
            return
        ddq = (np.array(command.dq) - motion.dq_d) / DT
        jerk = (ddq - motion.ddq_d) / DT
        shares = np.abs(ddq) / robot.acceleration, np.abs(jerk) / robot.jerk
        self.excess = [max(a, float(b.max())) for a, b in zip(self.excess, shares, strict=True)]
        if command.motion_finished:
            self.ended = max(map(abs, command.dq))
        answer = self.client.datagram(command.dq, last=command.motion_finished)
        self.core.receive(struct.pack("<Q", self._read) + answer[8:])

    def recover(self) -> None:
        """As a person asks for it; it takes its time."""
        self.client.ask("automatic_error_recovery")


def pylibfranka(arm: Arm) -> types.ModuleType:
    """The FR3's library."""

    class Control:
        def readOnce(self) -> tuple[Any, Duration]:
            state = arm.state()
            if arm.core.mode is not RobotMode.MOVE:
                raise ControlException("libfranka: motion aborted")
            return state, Duration(DT)

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
            if not arm.move():
                raise FrankaException(f"libfranka: Move command rejected in {arm.core.mode.name}")
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
            if not arm.move():
                raise RuntimeError(f"libfranka: Move command rejected in {arm.core.mode.name}")
            arm.ended = None
            try:
                while arm.ended is None:
                    arm.take(answer(arm.state(), Duration(DT)))
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
