"""What FR3 and Panda have in common: states, conditions, shaped velocities, the way to rest.

Every state is answered within its millisecond. A state that the driver does not answer by `send`
is answered here with velocities on the way to zero; at rest the motion is finished. So the arm
never gets a step to zero.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from surg_hardware.arm_driver import RobotRefused
from surg_hardware.conditions import franka_reading
from surg_hardware.franka import joint_limits
from surg_hardware.franka.versions import refusal
from surg_hardware.robot_adapter import (
    AdapterError,
    ArmIdentity,
    ArmState,
    RobotAdapter,
    finite_or_zero,
    numbers,
    refuse_unknown,
)
from surg_hardware.shaper import Shaper

JOINTS = 7
REST_VELOCITY, REST_ACCELERATION = 1e-4, 0.05
"""[rad/s], [rad/s^2] Below both, a motion may be finished."""
SLOW_CYCLES = 1000
"""For one second the connection is bad before that is said; a motion begins with no command."""
OPTIONS = ("collision_torque", "collision_force", "success_rate")
_ZERO = (0.0,) * JOINTS
_MOVING, _REFLEX = "move", "reflex"


def mode_name(mode: Any) -> str:
    """``user_stopped`` for ``RobotMode.UserStopped`` and ``RobotMode.kUserStopped``."""
    name = mode.name.removeprefix("k")
    return "".join("_" + c.lower() if c.isupper() else c for c in name).lstrip("_")


def error_names(errors: Any) -> list[str]:
    """Names of the errors that are set; about 50 us."""
    names = (name for name in dir(errors) if not name.startswith("_"))
    return [name for name in names if getattr(errors, name) is True]


class FrankaAdapter(RobotAdapter):
    """One arm by one of the two libraries; both name the members of a state alike."""

    cycle = 0.001
    # Of the datagrams that have come the library gives the newest one, so none is late. A simulator
    # may run at two thirds of real time.
    clock_window = 0.05
    model = ""
    limits: Sequence[joint_limits.JointLimits] = ()
    library: Any = None
    """The maker's module."""
    errors: tuple[type[Exception], ...] = ()
    """What its calls raise."""
    _robot: Any = None

    def __init__(self, address: str, options: Mapping[str, object]) -> None:
        super().__init__(address, options)
        refuse_unknown(options, OPTIONS)
        self._torque = numbers(options, "collision_torque", JOINTS, 1.0, 100.0)
        self._force = numbers(options, "collision_force", 6, 1.0, 100.0)
        rate = options.get("success_rate")
        if not isinstance(rate, float) or not 0.0 <= rate <= 1.0:
            raise ValueError(f"settings.success_rate: {rate!r}; allowed is 0 to 1")
        self._least_rate = rate
        self._shaper = Shaper(self.limits)
        self._newest: Any = None
        self._desired: tuple[float, Sequence[float]] = (-1.0, _ZERO)  # newest time and dq_d
        self._before: tuple[float, Sequence[float]] = self._desired
        self._slow = 0  # cycles with too few commands in time
        self._moving = self._ending = self._answered = False

    def connect(self) -> None:
        """As `RobotAdapter.connect`; sets the collision thresholds."""
        # The driver has asked for a real-time priority itself, and refuses a real arm without.
        try:
            self._robot = self.library.Robot(self.address, self.library.RealtimeConfig.kIgnore)
            torque, force = self._torque, self._force
            self._robot.set_collision_behavior(torque, torque, force, force)
        except self.errors as error:
            if why := refusal(str(error), self.model):
                raise RobotRefused(why) from error
            raise as_error(error) from error

    def recover(self) -> str:
        """As `RobotAdapter.recover`; the library blocks until the robot has recovered."""
        try:
            self._robot.automatic_error_recovery()
        except self.errors as error:
            return str(error)
        return ""

    # --- what each library does in its own way --------------------------------------------------

    @abstractmethod
    def _read(self) -> Any:
        """The next state; while moving, of the motion.

        Raises:
            AdapterError: The connection is lost.
            MotionEnded: The robot has ended the motion.
        """

    @abstractmethod
    def _begin(self) -> None:
        """Begin a motion by joint velocities.

        Raises:
            AdapterError: The robot does not take it.
        """

    @abstractmethod
    def _write(self, velocities: Sequence[float], finished: bool) -> None:
        """Answer the newest state of the motion.

        Raises:
            MotionEnded: The robot has ended the motion.
        """

    # --- the adapter ----------------------------------------------------------------------------

    def state(self) -> ArmState:
        """As `RobotAdapter.state`; an unanswered one is answered on the way to rest."""
        try:
            if self._moving and not self._answered:
                self._answer(_ZERO, self._ending)
            robot = self._read()
        except MotionEnded:
            self._moving = False
            robot = self._read()
        self._before, self._desired = self._desired, (robot.time.to_sec(), tuple(robot.dq_d))
        self._newest, self._answered = robot, False
        mode = mode_name(robot.robot_mode)
        errors: list[str] = []
        if mode == _REFLEX:
            errors = error_names(robot.current_errors) or error_names(robot.last_motion_errors)
        reading = franka_reading(mode, errors, self._slow_word(robot))
        return ArmState(
            robot.time.to_sec(),
            tuple(robot.q),
            tuple(robot.dq),
            reading,
            self._moving and mode == _MOVING,
            tuple(b - a for a, b in zip(robot.q, robot.q_d, strict=True)),
            finite_or_zero(robot.O_F_ext_hat_K),
        )

    def send(self, qd: Sequence[float]) -> None:
        """As `RobotAdapter.send`."""
        if not self._moving:
            self._shaper = Shaper(self.limits)
            self._begin()
            self._moving, self._ending, self._answered = True, False, True
            return
        try:
            self._answer(qd, False)
        except MotionEnded:
            self._moving = False

    def stop(self) -> None:
        """As `RobotAdapter.stop`: `state` slows the arm down and finishes the motion."""
        self._ending = True

    def identity(self) -> ArmIdentity:
        """Model by the library that connects to no other; the library tells no serial number."""
        robot = self._newest
        x, y, z = robot.F_x_Ctotal
        return ArmIdentity(
            self.model, flange_rows(robot.O_T_EE, robot.F_T_EE), None, robot.m_total, (x, y, z)
        )

    def _answer(self, qd: Sequence[float], ending: bool) -> None:
        robot = self._newest
        ddq_d = self._desired_acceleration()
        velocities = self._shaper.shape(qd, robot.q, robot.dq_d, ddq_d)
        rest = (
            max(abs(each) for each in robot.dq_d) < REST_VELOCITY
            and max(abs(each) for each in ddq_d) < REST_ACCELERATION
        )
        self._answered = True
        finished = ending and rest
        self._write(_ZERO if finished else velocities, finished)
        if finished:
            self._moving = False

    def _desired_acceleration(self) -> Sequence[float]:
        """Of the robot [rad/s^2]: the change of its desired velocity since the last state.

        Its own figure counts where states are missing. Elsewhere the two are the same on an arm;
        franky-sim, a simulator, reports it through a low-pass of 20 ms, and the shaper, which
        limits the jerk from there, would swing.
        """
        (time, dq_d), (time_before, dq_d_before) = self._desired, self._before
        if abs(time - time_before - self.cycle) > 0.1 * self.cycle:
            return tuple(self._newest.ddq_d)
        return [(new - old) / self.cycle for new, old in zip(dq_d, dq_d_before, strict=True)]

    def _slow_word(self, robot: Any) -> str:
        rate = robot.control_command_success_rate
        self._slow = self._slow + 1 if self._moving and rate < self._least_rate else 0
        if self._slow < SLOW_CYCLES:
            return ""
        return f"{100 * (1 - rate):.0f} % of the commands come late or are lost"


class MotionEnded(Exception):
    """The robot has ended the motion by itself: a reflex, a user stop, a lost connection."""


def as_error(error: Exception) -> AdapterError:
    """A library's exception with its own words."""
    return AdapterError(str(error).removeprefix("libfranka: ").strip() or type(error).__name__)


def flange_rows(O_T_EE: Sequence[float], F_T_EE: Sequence[float]) -> tuple[float, ...]:
    """Upper three rows of the flange's pose: ``O_T_EE`` less ``F_T_EE``, both column by column."""

    def at(T: Sequence[float], row: int, column: int) -> float:
        return T[4 * column + row]

    rows: list[float] = []
    for i in range(3):
        # R_OF = R_OE R_FE^T
        R = [sum(at(O_T_EE, i, k) * at(F_T_EE, j, k) for k in range(3)) for j in range(3)]
        p = at(O_T_EE, i, 3) - sum(R[j] * at(F_T_EE, j, 3) for j in range(3))
        rows += [*R, p]
    return tuple(rows)
