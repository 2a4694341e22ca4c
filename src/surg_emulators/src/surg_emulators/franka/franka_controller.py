"""An emulated controller of a Franka arm: values in, values out, no sockets and no clock.

One cycle lasts 1 ms: `cycle` executes the command that answered the last state, then `state` is the
next one. A command that answers an older state counts as lost.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from surg_emulators.franka import fci_messages as fci
from surg_emulators.franka import franka_kinematics as kinematics
from surg_emulators.franka.fci_messages import MotionCommand
from surg_emulators.franka.franka_errors import FLAGS, Error, Violation
from surg_emulators.franka.franka_robots import HOME, FrankaRobot
from surg_emulators.franka.generator_motion import DT, GeneratorMotion

MOST_LOST = 20
"""More lost packets in a row than these end a motion (Franka's documentation)."""
START_CYCLES = 500
"""A motion whose first command does not come within these cycles ends. Assumed."""
WINDOW = 100
"""Commands over which the success rate is taken (Franka's documentation)."""
RECOVERY_CYCLES = 200
"""Duration of the automatic error recovery [cycles]. Assumed; an arm takes longer."""
UNLOCK_CYCLES = 1000
"""From released brakes to idle [cycles]. Shorter than an arm's, to save time."""
THRESHOLD = 20.0
"""Default collision thresholds of forces and torques [N, Nm]. Assumed."""
MOST_STIFFNESS = 14250.0
"""Largest joint impedance [Nm/rad]. Assumed."""
MESSAGES = 200
IDENTITY = tuple(float(row == column) for column in range(4) for row in range(4))


class RobotMode(IntEnum):
    """Robot modes of the research interface."""

    OTHER = 0
    IDLE = 1
    MOVE = 2
    GUIDING = 3
    REFLEX = 4
    USER_STOPPED = 5
    AUTOMATIC_ERROR_RECOVERY = 6


@dataclass
class Motion:
    """A client's motion.

    Attributes:
        generator: `joint_velocity` or `joint_position`.
        controller: Number of the controller in a state.
        started: Whether its first command has come.
        lost: Packets lost in a row.
        finishing: The client has said that it ended.
        outcomes: Whether each of the last commands arrived.
    """

    generator: str
    controller: int
    started: bool = False
    lost: int = 0
    finishing: bool = False
    outcomes: deque[bool] = field(default_factory=lambda: deque(maxlen=WINDOW))


class FrankaController:
    """Modes, settings and motion of one arm.

    Args:
        robot: Its kind.
        serial: Serial number; the research interface does not tell it.
        q: Joint positions [rad].
        ready: Whether the brakes are released.

    Attributes:
        number: Of the newest state.
        answers: Answers to earlier commands that are due now: command and status.
        sent_late: Commands that answered an older state.
        faked: What states hold in place of the truth, as in `emulator_ports.Controller`.
    """

    def __init__(
        self, robot: FrankaRobot, serial: str = "", q: Sequence[float] = HOME, ready: bool = True
    ) -> None:
        self.robot, self.serial = robot, serial
        self.protocol = fci.PROTOCOLS[robot.version]
        self.motion = GeneratorMotion(robot, [float(value) for value in q])
        self.messages: deque[str] = deque(maxlen=MESSAGES)
        self.said = 0
        self.answers: deque[tuple[str, str]] = deque()
        self.boot()
        if ready:
            self.mode = RobotMode.IDLE

    def boot(self) -> None:
        """Start as after switching the controller on: settings and motion are lost, brakes on."""
        self.number = 0
        self.mode = RobotMode.OTHER
        self.active: Motion | None = None
        self.errors: set[Error] = set()
        self.reflex_reason: set[Error] = set()
        self.hand_dq = [0.0] * 7
        self.wrench = [0.0] * 6
        self.load = [0.0] * 13
        self.NE_T_EE, self.EE_T_K = list(IDENTITY), list(IDENTITY)
        self.force_thresholds = [THRESHOLD] * 6, [THRESHOLD] * 6  # contact, collision
        self.faked: dict[str, float] = {}
        self.sent_late = 0
        self.answers.clear()
        self._command: MotionCommand | None = None
        self._braking = False
        self._wait = 0

    def say(self, text: str) -> None:
        """A message for people."""
        self.messages.append(text)
        self.said += 1

    # Commands of a client ------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        """Take a command's datagram. Only the one that answers the newest state is executed."""
        command = fci.parse_command(self.protocol, data)
        if command is None:
            return
        if command.message != self.number:
            self.sent_late += 1
        else:
            self._command = command

    def move(self, controller: int, generator: str) -> str:
        """A motion is asked for; returns the status of the first answer."""
        if self.mode is not RobotMode.IDLE or self.active is not None:
            return "not_possible"
        if generator not in ("joint_velocity", "joint_position") or controller == 2:
            by = "torques" if controller == 2 else fci.CONTROLLERS[controller]
            self.say(f"not emulated: a motion by {generator} and {by}")
            return "invalid_argument"
        self.mode, self.active = RobotMode.MOVE, Motion(generator, controller)
        self.reflex_reason, self._command = set(), None
        return "started"

    def stop_move(self) -> str:
        """A client stops its motion."""
        if self.active is None:
            return "not_possible"
        self._end("preempted", RobotMode.IDLE)
        return "success"

    def recover(self) -> str:
        """Automatic error recovery; an empty status: the answer comes later."""
        if self.mode is RobotMode.IDLE:
            return "success"
        if self.mode is not RobotMode.REFLEX:
            return "not_possible"
        if not self._within_limits():
            return "manual"
        self.mode, self._wait = RobotMode.AUTOMATIC_ERROR_RECOVERY, RECOVERY_CYCLES
        return ""

    def set(self, name: str, values: Sequence[float]) -> str:
        """A setting; returns the status."""
        if self.active is not None:
            return "not_possible"
        if not np.isfinite(values).all():
            return "invalid_argument"
        setters: dict[str, Callable[[Sequence[float]], bool]] = {
            "set_collision_behavior": self._set_thresholds,
            "set_joint_impedance": self._set_joint_impedance,
            "set_cartesian_impedance": lambda k: min(k) > 0.0,
            "set_ee_to_k": lambda pose: self._set_frame("EE_T_K", pose),
            "set_ne_to_ee": lambda pose: self._set_frame("NE_T_EE", pose),
            "set_load": self._set_load,
            "set_filters": lambda hertz: min(hertz) > 0.0 and max(hertz) <= 1000.0,
        }
        taken = setters.get(name, lambda values: True)(values)
        return "success" if taken else "invalid_argument"

    def _set_thresholds(self, values: Sequence[float]) -> bool:
        if min(values) <= 0.0:
            return False
        self.force_thresholds = list(values[40:46]), list(values[46:52])
        return True

    def _set_joint_impedance(self, stiffness: Sequence[float]) -> bool:
        if not (min(stiffness) >= 0.0 and max(stiffness) <= MOST_STIFFNESS):
            return False
        self.motion.set_stiffness(stiffness)
        return True

    def _set_frame(self, name: str, pose: Sequence[float]) -> bool:
        matrix = kinematics.from_columns(pose)
        rotation = matrix[:3, :3]
        good = np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-5) and np.allclose(
            rotation @ rotation.T, np.eye(3), atol=1e-4
        )
        if good:
            setattr(self, name, list(pose))
        return bool(good)

    def _set_load(self, values: Sequence[float]) -> bool:
        if values[0] < 0.0:
            return False
        self.load = list(values)
        return True

    # What people and the surroundings do ---------------------------------------------------------

    def reflex(self, error: Error, text: str) -> None:
        """The arm stops by itself; only the recovery ends it."""
        if self.mode not in (RobotMode.MOVE, RobotMode.IDLE):
            return
        self.errors, self.reflex_reason = {error}, {error}
        self.say(f"reflex {error.name}: {text}")
        self._end("reflex", RobotMode.REFLEX)

    def user_stop(self, pressed: bool) -> None:
        """The user stop's button is pressed or released."""
        if pressed and self.mode is not RobotMode.OTHER:
            self._end("emergency", RobotMode.USER_STOPPED)
        elif not pressed and self.mode is RobotMode.USER_STOPPED:
            self.mode = RobotMode.REFLEX if self.errors else RobotMode.IDLE

    def guide(self, on: bool, dq: Sequence[float]) -> bool:
        """A hand guides the arm with joint velocities [rad/s]; whether that is possible now.

        It is for an idle arm, and for one that no recovery brings back within its limits.
        """
        free = self.mode is RobotMode.IDLE or (
            self.mode is RobotMode.REFLEX and not self._within_limits()
        )
        if self.mode is not RobotMode.GUIDING and not (free and self.motion.at_rest):
            return False
        self.hand_dq = list(dq)
        if on:
            self.mode = RobotMode.GUIDING
        else:
            self.motion.lock()
            self.mode = RobotMode.REFLEX if self.errors else RobotMode.IDLE
        return True

    def brakes(self, released: bool) -> None:
        """The brakes are closed, or released: idle after a second."""
        if released and self.mode is RobotMode.OTHER:
            self._wait = UNLOCK_CYCLES
        elif not released:
            self._end("aborted", RobotMode.OTHER)
            self._wait = 0

    def push(self, wrench: Sequence[float]) -> None:
        """Something pushes the end effector, in the base frame [N, Nm], 6."""
        self.wrench = list(wrench)

    def disconnect(self) -> None:
        """The client has left."""
        self._command = None
        if self.active is not None:
            error = Error.communication_constraints_violation
            self.errors, self.reflex_reason = {error}, {error}
            self.say(f"reflex {error.name}: the client has left")
            self._end("reflex", RobotMode.REFLEX)
        self.answers.clear()

    # One cycle -----------------------------------------------------------------------------------

    def cycle(self) -> None:
        """Execute the command that answered the last state."""
        command, self._command = self._command, None
        if self.active is not None:
            self._follow(self.active, command)
        elif self.mode is RobotMode.GUIDING:
            self.motion.drag(self.hand_dq)
        elif self._braking:
            self.motion.brake()
            self._braking = not self.motion.at_rest
        elif self.mode is RobotMode.OTHER:
            self.motion.lock()
        else:
            self.motion.settle()
        self._collide()
        self._pass_time()
        self.number += 1

    def _follow(self, active: Motion, command: MotionCommand | None) -> None:
        """One cycle of a client's motion."""
        try:
            if active.finishing:
                self.motion.brake()
                if self.motion.at_rest:
                    self._end("success", RobotMode.IDLE)
            elif command is None:
                self._miss(active)
            else:
                self._obey(active, command)
        except Violation as violation:
            self.reflex(violation.error, str(violation))
            self.motion.brake()

    def _obey(self, active: Motion, command: MotionCommand) -> None:
        first, active.started, active.lost = not active.started, True, 0
        active.outcomes.append(True)
        if active.generator == "joint_velocity":
            self.motion.velocity_command(command.dq)
        else:
            self.motion.position_command(command.q, first)
        if command.finished:
            self.motion.end()
            active.finishing = True

    def _miss(self, active: Motion) -> None:
        active.lost += 1
        if not active.started:
            self.motion.settle()
        else:
            active.outcomes.append(False)
            self.motion.lost_packet()
        most = MOST_LOST if active.started else START_CYCLES
        if active.lost > most:
            raise Violation(
                Error.communication_constraints_violation, f"{active.lost} packets lost in a row"
            )

    def _collide(self) -> None:
        if self.active is None or not any(self.wrench):
            return
        for axis, most in enumerate(self.force_thresholds[1]):
            if abs(self.wrench[axis]) > most:
                text = f"axis {axis + 1}: {self.wrench[axis]:.1f}, threshold {most:.1f}"
                self.reflex(Error.cartesian_reflex, text)
                return

    def _pass_time(self) -> None:
        if self._wait == 0:
            return
        self._wait -= 1
        if self._wait:
            return
        if self.mode is RobotMode.AUTOMATIC_ERROR_RECOVERY:
            self.errors, self.mode = set(), RobotMode.IDLE
            self.answers.append(("automatic_error_recovery", "success"))
        elif self.mode is RobotMode.OTHER:
            self.mode = RobotMode.IDLE

    def _end(self, status: str, mode: RobotMode) -> None:
        """The motion, where there is one, ends with a status; the arm brakes."""
        if self.mode is RobotMode.AUTOMATIC_ERROR_RECOVERY:
            self.answers.append(("automatic_error_recovery", "aborted"))
            self._wait = 0
        if self.active is not None:
            self.answers.append(("move", status))
        self.active, self.mode = None, mode
        self._braking = not self.motion.at_rest

    def _within_limits(self) -> bool:
        robot = self.robot
        limits = zip(robot.position_min, self.motion.q, robot.position_max, strict=True)
        return all(low <= q <= high for low, q, high in limits)

    # What a client sees --------------------------------------------------------------------------

    @property
    def success_rate(self) -> float:
        """Share of the last commands that arrived; 0 where no motion runs."""
        outcomes = self.active.outcomes if self.active is not None else ()
        return sum(outcomes) / len(outcomes) if outcomes else 0.0

    def state(self) -> bytes:
        """The state's datagram."""
        protocol, motion = self.protocol, self.motion
        poses = kinematics.flange((motion.q, motion.q_d)) @ kinematics.from_columns(self.NE_T_EE)
        pose, wanted = poses[0], kinematics.to_columns(poses[1])
        found: dict[str, Sequence[float]] = {
            "O_T_EE": kinematics.to_columns(pose),
            "O_T_EE_d": wanted,
            "O_T_EE_c": wanted,
            "F_T_EE": self.NE_T_EE,
            "EE_T_K": self.EE_T_K,
            "F_T_NE": IDENTITY,
            "NE_T_EE": self.NE_T_EE,
            "m_load": self.load[:1],
            "F_x_Cload": self.load[1:4],
            "I_load": self.load[4:],
            "elbow": (motion.q[2], -1.0 if motion.q[3] < 0.0 else 1.0),
            "elbow_d": (motion.q_d[2], -1.0 if motion.q_d[3] < 0.0 else 1.0),
            "q": motion.q,
            "q_d": motion.q_d,
            "dq": motion.dq,
            "dq_d": motion.dq_d,
            "ddq_d": motion.ddq_d,
            "theta": motion.q,
            "dtheta": motion.dq,
            "O_ddP_O": (0.0, 0.0, -9.81),
            **(self._contacts(pose) if any(self.wrench) else {}),
        }
        values = [0.0] * protocol.numbers
        for name, part in found.items():
            values[protocol.places[name]] = part
        if "q" in self.faked:
            values[protocol.places["q"]] = [self.faked["q"]] * 7
        modes = (*self._generator_modes(), int(self.faked.get("mode", self.mode)))
        return fci.pack_state(
            protocol,
            max(0, self.number - round(self.faked.get("back", 0.0) / DT)),
            values,
            modes,
            _flags(self.errors),
            _flags(self.reflex_reason),
            self.success_rate,
        )

    def _generator_modes(self) -> tuple[int, int]:
        if self.active is None:
            return fci.IDLE_GENERATOR, fci.IDLE_CONTROLLER
        return fci.MODE_NAMES.index(self.active.generator) + 1, self.active.controller

    def _contacts(self, pose: kinematics.Matrix) -> dict[str, Sequence[float]]:
        axes = (pose @ kinematics.from_columns(self.EE_T_K))[:3, :3]
        wrench, (contact, collision) = np.array(self.wrench), self.force_thresholds
        return {
            "O_F_ext_hat_K": self.wrench,
            "K_F_ext_hat_K": [*(wrench[:3] @ axes), *(wrench[3:] @ axes)],
            "cartesian_contact": (abs(wrench) > contact).astype(float).tolist(),
            "cartesian_collision": (abs(wrench) > collision).astype(float).tolist(),
        }


def _flags(errors: set[Error]) -> bytes:
    if not errors:
        return bytes(FLAGS)
    return bytes(index in errors for index in range(FLAGS))
