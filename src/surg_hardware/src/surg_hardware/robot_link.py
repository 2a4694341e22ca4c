"""The link between the controller's commands and one arm, whatever its vendor.

Pure: a robot's state, the newest command and the time go in, the velocity for the robot and the
link's status come out. The rules:

* Nothing moves before `RobotLink.start`, which a person asks for. It is refused while the
  controller is ENABLED or has just commanded motion: an arm that starts under a command leaps.
* Whatever ends the motion latches until the next start: the robot's own stop, a silent controller,
  a slowed robot, a command that must not be obeyed (the link ramps the arm down along a straight
  line in joint space, `stop_ramp`), a late or restarted robot.
* The last check before the wire: number of joints, finite, velocity; the change within a cycle is
  limited, with the direction of the change kept.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from surg_hardware.conditions import OFFLINE, START, Condition, Reading
from surg_hardware.stop_ramp import StopRamp

MOVING = 1e-3
"""[rad/s] A command above it is motion."""
QUIET = 1.0
"""[s] `start` is refused if motion was commanded within this time."""
SETTLED = 2.0
"""[s] `start` is refused until states have come for this time: a UR restarts RTDE as it boots."""
START_TIMEOUT = 3.0
"""[s] For the robot to obey after a start, unless its vendor's server may take longer."""
ECHO_TIMEOUT = 0.04
"""[s] Without an executed command, after which the program on the robot counts as ended."""
PAUSE = 0.04
"""[s] The longest pause of a robot and its clock that a motion bears; a real one makes none."""
STILL = 0.2
"""Share of the fastest joint's speed by which an arm may differ that still moves as commanded."""
_KEPT = 64
"""Sent commands whose stamps are remembered."""


@dataclass(frozen=True)
class Settings:
    """Of a link and its arm; ``velocity`` and ``acceleration`` have one value per joint."""

    velocity: tuple[float, ...]  # [rad/s] a larger command is refused
    acceleration: tuple[float, ...]  # [rad/s^2] a larger change is spread over cycles
    dead_man: float  # [s] without a command, after which the link ramps down
    stop_deceleration: float  # [rad/s^2] of the leading joint in that ramp
    cycle: float = 0.002  # [s] of the robot
    start_timeout: float = START_TIMEOUT  # [s] for the robot to obey after a start


@dataclass(frozen=True)
class RobotState:
    """One state of the robot: angles [rad] and velocities [rad/s], one per joint."""

    time: float  # on the robot's clock [s]
    q: tuple[float, ...]
    qd: tuple[float, ...]
    reading: Reading
    program: bool = False  # whether a program runs on the robot
    executed: int = 0  # number of the command that the program obeys
    ahead: tuple[float, ...] = ()  # targets of its joints minus their angles [rad]; empty: unknown
    paused: bool = False  # whether its program waits, and goes on when a person presses play
    wrench: tuple[float, ...] = ()  # from outside, as in `StateDatagram`; empty: not measured


@dataclass(frozen=True)
class Command:
    """The newest joint velocities of the controller [rad/s], their stamp, and their arrival [s]."""

    qd: tuple[float, ...]
    stamp_ns: int
    received: float


@dataclass(frozen=True)
class Status:
    """What the link says; as in surg_msgs/LinkStatus."""

    condition: Condition
    fault: str
    dead_man: bool
    last_command_ns: int
    speed_scaling: float


@dataclass(frozen=True)
class LinkStep:
    """One cycle: the velocity for the robot with its number; ``qd`` None: nothing is sent.

    Zeros with the number of before end the motion: a program that a person resumes after a stop
    finds no old velocity. The robot itself may keep the old speed of a paused program and give it
    back on `play`: where `end_program` is set, the driver ends the program.
    """

    qd: tuple[float, ...] | None
    number: int
    status: Status
    end_program: bool = False


class CommandPhase:
    """How long the driver waits for the next command when a state has come.

    Robot and controller have cycles of their own. Where a command usually comes just after the
    state, it is waited for: otherwise each jitter would repeat one command and skip the next. With
    a hysteresis, because a choice that changes to and fro does the same.
    """

    def __init__(self, cycle: float = 0.002) -> None:
        self._cycle, self._waits = cycle, False

    def wait(self, age: float) -> float:
        """The longest wait [s] for the next command, when the newest one has this age [s]."""
        if age > 2 * self._cycle:
            return 0.0  # commands do not come in time anyway
        self._waits = age > (0.5 if self._waits else 0.85) * self._cycle
        return max(1.2 * self._cycle - age, 0.0) if self._waits else 0.0


class _Phase(Enum):
    IDLE = 0
    STARTING = 1  # zeros are sent until the robot echoes their numbers
    ACTIVE = 2
    ENDING = 3  # the link ramps down by itself


class RobotLink:
    """One arm's link; call `step` once for each state, `lost` where states stop coming."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._phase = _Phase.IDLE
        self._why = ""  # why the last motion ended, until the next start
        self._stalled = ""  # that our own stall ended it, until the robot is ready again
        self._reading = OFFLINE
        self._silent = False
        self._driving = False  # whether a velocity was sent in the last cycle
        self._ours = False  # whether the program on the robot is this link's
        self._sent = tuple(0.0 for _ in settings.velocity)
        self._ramp: StopRamp | None = None  # while it ends
        self._number = self._first = self._executed = 0
        self._stamps: deque[tuple[int, int]] = deque(maxlen=_KEPT)
        self._last_command_ns = 0
        self._last_motion = -math.inf  # of a command, on our clock
        self._last_time = math.nan  # of a state, on the robot's clock
        self._last_now = self._since = self._echoed = math.nan

    @property
    def active(self) -> bool:
        """Whether the robot is driven, if only to rest."""
        return self._phase is not _Phase.IDLE

    @property
    def at_rest(self) -> bool:
        """Whether the velocity sent last is zero."""
        return not any(self._sent)

    # --- requests -------------------------------------------------------------------------------

    def start(self, enabled: bool, known_for: float, now: float) -> str:
        """Begin to drive the robot; the caller then starts the program on it.

        Args:
            enabled: Whether the controller is ENABLED.
            known_for: How long the robot's states have come without a restart [s].
            now: Our time [s].

        Returns:
            Why not, in one sentence; empty: it begins.
        """
        if self._phase is not _Phase.IDLE:
            return "the robot is already started"
        if self._reading.condition is not Condition.READY:
            return self._reading.text
        if enabled:
            return "the controller is ENABLED: disable it, then start the robot"
        if now - self._last_motion < QUIET:
            return f"the controller commanded motion less than {QUIET:g} s ago: stop it first"
        if known_for < SETTLED:
            return f"the robot has answered for less than {SETTLED:g} s: wait"
        self._phase, self._why, self._since = _Phase.STARTING, "", now
        self._ours = True
        self._sent = tuple(0.0 for _ in self._sent)
        # An old echo must not pass for a new one.
        self._number = self._first = (self._executed + 1000) % 2**30
        self._stamps.clear()
        return ""

    def end(self, why: str) -> None:
        """Ramp down and stop driving the robot, until the next start."""
        if self._phase in (_Phase.STARTING, _Phase.ACTIVE):
            self._phase, self._why, self._ramp = _Phase.ENDING, why, None

    def lost(self, reading: Reading = OFFLINE) -> Status:
        """No state comes any more, or none that is of use; returns the status."""
        if self._phase is not _Phase.IDLE:
            self._drop(reading.sentence)
        self._reading = reading
        self._last_time = self._last_now = math.nan
        return self._status()

    # --- one cycle ------------------------------------------------------------------------------

    def step(self, state: RobotState, command: Command | None, now: float) -> LinkStep:
        """Answer one state of the robot.

        Args:
            state: The newest one.
            command: The newest one, whether or not it was seen before; None: none has come.
            now: Our time [s].
        """
        elapsed = self._elapsed(state, now)
        self._read(state, now)
        problem = self._problem(command)
        if command is not None and self._is_motion(command.qd):
            self._last_motion = max(self._last_motion, command.received)
        silent = command is None or not now - command.received <= self._settings.dead_man
        self._silent = silent
        if self._phase is _Phase.STARTING and now - self._since > self._settings.start_timeout:
            within = f"{self._settings.start_timeout:g} s"
            self._drop(f"the robot did not obey within {within}: is it in remote control?")
        if self._phase is _Phase.ACTIVE:
            if problem:
                self.end(problem)
            elif silent and not self.at_rest:
                self.end(f"no command for {1e3 * self._settings.dead_man:.0f} ms")
            elif state.reading.condition is Condition.SLOWED:
                self.end(self._reading.sentence)
        if self._phase is _Phase.IDLE:
            self._sent = tuple(0.0 for _ in self._sent)
            ended, self._driving = self._driving, False
            self._ours &= state.program or state.paused
            qd = self._sent if ended else None
            return LinkStep(qd, self._number, self._status(), self._ours and state.paused)
        self._driving = True
        if self._phase is _Phase.ACTIVE and not silent and command is not None:
            self._sent = self._toward(command.qd, elapsed)
        elif self._phase is _Phase.ENDING:
            if self._ramp is None:
                self._ramp = StopRamp(self._sent, state.ahead, self._settings.stop_deceleration)
                elapsed = self._settings.cycle  # the arm cannot brake for what was missed
            self._sent = self._ramp.velocity(elapsed)
        self._number += 1
        self._stamps.append((self._number, 0 if command is None else command.stamp_ns))
        step = LinkStep(self._sent, self._number, self._status())
        if self._phase is _Phase.ENDING and self.at_rest:
            self._drop(self._why)
        return step

    def _elapsed(self, state: RobotState, now: float) -> float:
        """Time since the last state [s]; a stall ends the motion.

        An arm that still moves as it was told is brought to rest along the ramp: braking joint by
        joint would take the shaft off its pivot. One that has stopped by itself gets nothing more.
        """
        cycle = self._settings.cycle
        gap, passed = now - self._last_now, state.time - self._last_time
        if not gap <= self._settings.dead_man and self._phase is _Phase.ACTIVE:
            self._judge_stall(state, gap, passed)
        self._last_now, self._last_time = now, state.time
        return min(max(passed, cycle), self._settings.dead_man) if passed > 0 else cycle

    def _judge_stall(self, state: RobotState, gap: float, passed: float) -> None:
        """End the motion after a gap between two states [s], by whose stall it was.

        The robot's own clock tells: where it has hardly gone on, the robot stood still, and missed
        no command. A short pause of it is borne.
        """
        paused = 0.0 < passed <= self._settings.dead_man
        if paused and gap <= PAUSE:
            return
        who = "robot" if paused else "driver"
        self._stalled = f"the {who} stood still for {1e3 * gap:.0f} ms"
        off = max(abs(speed - told) for speed, told in zip(state.qd, self._sent, strict=True))
        if off <= STILL * max(abs(told) for told in self._sent):
            self.end(self._stalled)
        else:
            self._drop(self._stalled)

    def _read(self, state: RobotState, now: float) -> None:
        """Take what the robot says of itself, and end the motion where it has ended it."""
        self._reading = state.reading
        stamp = next((ns for number, ns in self._stamps if number == state.executed), None)
        new = state.executed != self._executed
        self._executed = state.executed
        if new and stamp is not None:
            self._echoed = now
            self._last_command_ns = stamp or self._last_command_ns
            if self._phase is _Phase.STARTING and state.program:
                self._phase = _Phase.ACTIVE
        if self._phase is _Phase.IDLE:
            if state.reading.condition is Condition.READY:
                self._stalled = ""
            return
        good = (Condition.READY, Condition.SLOWED)
        if state.reading.condition not in good:
            self._drop(self._stalled or state.reading.sentence)
        elif self._phase is not _Phase.STARTING and (
            not state.program or now - self._echoed > ECHO_TIMEOUT
        ):
            self._drop(self._stalled or "the program on the robot has ended")

    def _problem(self, command: Command | None) -> str:
        """Why a command must not be obeyed; empty: it may."""
        if command is None:
            return ""
        limits = self._settings.velocity
        if len(command.qd) != len(limits):
            return f"a command of {len(command.qd)} joints was refused; the arm has {len(limits)}"
        for joint, (value, limit) in enumerate(zip(command.qd, limits, strict=True), 1):
            if not abs(value) <= limit:
                return (
                    f"a command of {value:.3g} rad/s for joint {joint} was refused; allowed is "
                    f"{limit:.3g} rad/s"
                )
        return ""

    def _toward(self, wanted: Sequence[float], elapsed: float) -> tuple[float, ...]:
        """The velocity on the straight way to the wanted one that the acceleration allows."""
        share = 1.0
        pairs = list(zip(self._sent, wanted, self._settings.acceleration, strict=True))
        for now, then, acceleration in pairs:
            if abs(then - now) > acceleration * elapsed:
                share = min(share, acceleration * elapsed / abs(then - now))
        if share == 1.0:
            return tuple(wanted)
        return tuple(now + share * (then - now) for now, then, _ in pairs)

    def _is_motion(self, qd: Sequence[float]) -> bool:
        return any(not abs(value) <= MOVING for value in qd)

    def _drop(self, why: str) -> None:
        """Stop driving at once: the robot stops by itself, or rests."""
        self._phase, self._why = _Phase.IDLE, why
        self._sent = tuple(0.0 for _ in self._sent)

    def _status(self) -> Status:
        reading = self._reading
        condition, fault = reading.condition, reading.text
        if condition is Condition.STOPPED and self._stalled:
            fault = f"{self._stalled}; {fault}"
        if condition is Condition.READY:
            if self._phase is _Phase.ACTIVE:
                condition, fault = Condition.ACTIVE, ""
            elif self._phase is _Phase.STARTING:
                fault = "the robot is being started"
            else:
                ended = self._why and f", as the last motion has ended: {self._why}"
                fault = f"the robot is not started{ended}: {START}"
        return Status(
            condition,
            fault,
            self._phase is _Phase.ENDING or (self._phase is _Phase.ACTIVE and self._silent),
            self._last_command_ns,
            reading.speed_scaling,
        )
