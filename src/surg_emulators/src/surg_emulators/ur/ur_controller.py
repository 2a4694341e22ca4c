"""An emulated controller of a UR e-Series arm: values in, values out, no sockets and no clock.

One cycle lasts 2 ms. `advance` moves the arm; then clients see the state; `execute` runs the
program with what clients had sent before the cycle. So a register is read one cycle after the state
that it answers, and the motion that it commands begins in the cycle after that.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur import robot_messages
from surg_emulators.ur.joint_motion import DT, LAGS, REST, Command, JointMotion
from surg_emulators.ur.robot_messages import RobotMessage
from surg_emulators.ur.robot_states import DEAD, MOVES, RobotMode, Runtime, SafetyMode
from surg_emulators.ur.rtde_fields import REGISTERS
from surg_emulators.ur.urscript_functions import functions
from surg_emulators.ur.urscript_machine import Machine
from surg_emulators.ur.urscript_sockets import ScriptSockets
from surg_emulators.ur.urscript_syntax import ScriptError, UnknownName

HOME = (0.0, -1.5708, -1.5708, -1.5708, 1.5708, 0.0)
UNLOCK_AFTER = 5.0
"""A protective stop cannot be unlocked earlier [s] (dashboard server's own reply)."""
SCALING_RATE = 5.0
"""Change of the speed scaling towards the slider [1/s]. Assumed."""
POWER_TIME = 1.0
"""From power off to idle, and from idle to running [s]. Shorter than an arm's, to save time."""
BOOT_TIME = 4.0
"""From the controller's start to power off [s]. An arm takes half a minute."""
MESSAGES = 200
"""Text messages kept for clients and people."""
VERSIONS = {"5": (5, 12, 0, 1101319), "x": (10, 14, 0, 1)}
"""PolyScope -> version of the controller's software: major, minor, bugfix, build."""


@dataclass
class Watchdog:
    """RTDE's watchdog: a program stops when a client no longer writes a field.

    Attributes:
        field: The input field.
        period: Longest time between two writes [s]; 0 means none.
        action: `pause`, `stop` or `ignore`.
        last: Time of the last write [s].
    """

    field: str
    period: float
    action: str
    last: float


class UrController:
    """Modes, safety, program, registers and motion of one arm.

    Args:
        model: `UR3e`, `UR5e` or `UR10e`.
        serial: Serial number.
        q: Joint positions [rad].
        dh_errors: Calibration of this arm: corrections of d [m], a [m] and alpha [rad] of each
            joint, added to the model's.
        ready: Whether the arm is powered with the brakes released; otherwise it is off.
        lags: Of each joint behind its target [s].
        polyscope: `5`, or `x` for PolyScope X.

    Attributes:
        version: Of its software: major, minor, bugfix, build.
    """

    def __init__(
        self,
        model: str = "UR5e",
        serial: str = "20225500001",
        q: Sequence[float] = HOME,
        dh_errors: Sequence[tuple[float, float, float]] = ((0.0, 0.0, 0.0),) * 6,
        ready: bool = True,
        lags: Sequence[float] = LAGS,
        polyscope: str = "5",
    ) -> None:
        self.model, self.serial, self.version = model, serial, VERSIONS[polyscope]
        self.dh_errors = dh_errors
        nominal = dh.TABLES[model]
        self.table: dh.Table = [
            (d + e[0], a + e[1], alpha + e[2])
            for (d, a, alpha), e in zip(nominal, dh_errors, strict=True)
        ]
        self.motion = JointMotion([float(value) for value in q], lags=lags)
        self.remote = True
        self.payload, self.payload_cog = 0.0, [0.0] * 3
        self.tcp_offset = [0.0] * 6
        self.wrench = [0.0] * 6
        self.slider = 1.0
        self.messages: deque[str] = deque(maxlen=MESSAGES)
        self.said = 0
        self.announced: deque[RobotMessage] = deque(maxlen=MESSAGES)
        self.announcements = 0
        self.programs: dict[str, str] = {}
        self.loaded = ""
        self.faked: dict[str, float] = {}
        self.sockets = ScriptSockets()
        self._builtins = functions(self)
        self.boot()
        self.robot_mode = RobotMode.RUNNING if ready else RobotMode.POWER_OFF

    def boot(self) -> None:
        """Start as after switching the controller on: registers, program and time are lost."""
        self.cycles = 0
        self.robot_mode = RobotMode.BOOTING
        self.safety_mode = self._announced_safety = SafetyMode.NORMAL
        self._scale = 1.0  # of every motion: slider and pause together
        self.guided = False
        self.hand_qd = [0.0] * 6
        self.digital_outputs = 0
        self.claims: dict[str, object] = {}
        self.inputs = _registers()
        self.outputs = _registers()
        self.program: Machine | None = None
        self.runtime = Runtime.STOPPED
        self.program_line = 0
        self._staged: dict[str, Any] = {}
        self._arrived: dict[str, Any] = {}
        self._watchdog: Watchdog | None = None
        self._interrupted: Command | None = None  # by a stop for safety; `play` goes on with it
        self._stopped_at = -math.inf
        self._braking = False
        self.reduced = False
        self._power_goal = RobotMode.POWER_OFF
        self._power_at = BOOT_TIME

    # What clients see ------------------------------------------------------------------------

    @property
    def timestamp(self) -> float:
        """Time since the controller's start, by its own clock [s]."""
        return self.cycles * DT - self.faked.get("back", 0.0)

    @property
    def powered(self) -> bool:
        """Whether the motors have power."""
        return self.robot_mode in (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING)

    @property
    def program_runs(self) -> bool:
        """Whether a program runs or is paused."""
        return self.program is not None

    @property
    def program_state(self) -> str:
        """Of the program, in the words of dashboard and robot API."""
        paused = self.runtime in (Runtime.PAUSED, Runtime.PAUSING)
        return "PAUSED" if paused else "PLAYING" if self.runtime == Runtime.PLAYING else "STOPPED"

    @property
    def shown_mode(self) -> int:
        """The robot mode that clients read: a fault can replace it."""
        return int(self.faked.get("mode", self.robot_mode))

    @property
    def shown_q(self) -> Sequence[float]:
        """The joint positions that clients read [rad]: a fault can replace them."""
        return [self.faked["q"]] * 6 if "q" in self.faked else self.motion.actual_q

    def tcp_pose(self, q: Sequence[float]) -> list[float]:
        """Tool centre point in `base`: position [m] and rotation vector [rad]."""
        return dh.pose_vector(dh.frames(q, self.table)[-1] @ dh.pose_matrix(self.tcp_offset))

    def tcp_speed(self, q: Sequence[float], qd: Sequence[float]) -> list[float]:
        """Twist of the tool centre point in `base` [m/s, rad/s]."""
        J = dh.jacobian(q, self.table, dh.pose_matrix(self.tcp_offset))
        return [float(value) for value in J @ list(qd)]

    def elbow(self) -> list[float]:
        """Position of the elbow in `base` [m]."""
        return [float(value) for value in dh.frames(self.motion.actual_q, self.table)[2][:3, 3]]

    # One cycle -------------------------------------------------------------------------------

    def advance(self) -> None:
        """First half of a cycle: time, power and motion."""
        self.cycles += 1
        self._arrived, self._staged = self._staged, {}
        if self.safety_mode != self._announced_safety:
            self._announced_safety = self.safety_mode
            self.announce(robot_messages.safety_mode(self.safety_mode))
        self._switch_power()
        if self.robot_mode != RobotMode.RUNNING:
            self._hold()
            return
        if self.guided:
            self.motion.drag(self.hand_qd)
            return
        if not self._braking:
            self._scale_speed()
        broken = self.motion.step()
        if broken:
            self.protective_stop(broken)
            self.motion.step()
        if self._braking and self.motion.at_rest:
            self._braking = False
            if self.safety_mode in DEAD:
                self._power_down()

    def execute(self) -> None:
        """Second half of a cycle: take over inputs, run the program."""
        for name, value in self._arrived.items():
            self._set_input(name, value, self._arrived)
        self._check_watchdog(self._arrived)
        if self.program is None or self.runtime != Runtime.PLAYING or self._braking:
            return
        try:
            self.program.cycle()
        except ScriptError as error:
            self._fail(f"{self.program.name}: ", error)
            self.stop()
            return
        self.program_line = self.program.threads[0].line
        if not self.program.running:
            self.stop()

    def stage(self, values: Mapping[str, Any]) -> None:
        """Inputs of a client; they count from the next cycle on."""
        self._staged.update(values)

    def _set_input(self, name: str, value: Any, written: Mapping[str, Any]) -> None:
        """Take over one input; a mask of the same client says whether the value is meant."""
        parts = name.split("_")
        if name.startswith("input_bit_registers"):
            first = 0 if name.endswith("0_to_31") else 32
            bits = [bool(value >> place & 1) for place in range(32)]
            self.inputs["bit"][first : first + 32] = bits
        elif parts[0] == "input":
            self.inputs[parts[1]][int(parts[3])] = value
        elif name == "speed_slider_fraction":
            if written.get("speed_slider_mask", 0) and 0.0 <= value <= 1.0:
                self.slider = value
        elif name in ("standard_digital_output", "configurable_digital_output"):
            shift = 0 if name.startswith("standard") else 8
            mask = int(written.get(f"{name}_mask", 0)) << shift
            self.digital_outputs = self.digital_outputs & ~mask | int(value) << shift & mask
        elif name == "external_force_torque":
            self.wrench = list(value)

    def _scale_speed(self) -> None:
        """Let the speed follow the slider; it goes to 0 while a program is paused."""
        paused = self.runtime in (Runtime.PAUSING, Runtime.PAUSED)
        goal = 0.0 if paused else self.slider
        step = SCALING_RATE * DT
        self._scale += min(max(goal - self._scale, -step), step)
        self.motion.scale = self._scale
        if self.runtime == Runtime.PAUSING and self._scale == 0.0:
            self.runtime = Runtime.PAUSED

    # Program ---------------------------------------------------------------------------------

    @property
    def ready_for_program(self) -> bool:
        """Whether a program may run now."""
        return self.robot_mode == RobotMode.RUNNING and self.safety_mode in MOVES

    def run_script(self, script: str) -> bool:
        """Run a program at once, as the script ports do; ends the one that runs."""
        if not self.ready_for_program:
            self.say("the program was not started: the arm is not running or stopped for safety")
            return False
        try:
            program = Machine(script, self._builtins)
        except ScriptError as error:
            self._fail("the program was refused: ", error)
            return False
        self.stop()
        self.guided = False
        self._scale = self.slider
        self.program, self.runtime = program, Runtime.PLAYING
        self.announce(robot_messages.key("PROGRAM_XXX_STARTED", program.name))
        return True

    def run_secondary(self, script: str) -> bool:
        """Run a program that may not move the arm, beside the other one, in one cycle."""
        try:
            Machine(script, self._builtins).cycle()
        except ScriptError as error:
            self._fail("the program was refused: ", error)
            return False
        return True

    def load(self, name: str) -> bool:
        """Load one of the controller's programs for `play`."""
        if name not in self.programs:
            return False
        self.loaded = name
        return True

    def play(self) -> bool:
        """Go on with the paused program, or start the loaded one in the place of any other."""
        if not self.ready_for_program:
            return False
        if self.program is not None and not (self.runtime == Runtime.PLAYING and self.loaded):
            self.runtime = Runtime.PLAYING
            self._interrupted, command = None, self._interrupted
            self.motion.command = command or self.motion.command
            return True
        return bool(self.loaded) and self.run_script(self.programs[self.loaded])

    def pause(self) -> bool:
        """Pause the program: the arm slows down along its way."""
        if self.program is None or self.runtime != Runtime.PLAYING:
            return False
        self.runtime = Runtime.PAUSING
        return True

    def stop(self) -> None:
        """End the program and stop the arm."""
        if self.program is not None:
            self.guided = False  # free-drive ends with the program that asked for it
            self._brake()
            self.announce(robot_messages.key("PROGRAM_XXX_STOPPED", self.program.name))
            self.sockets.close_all()
        self.program, self.runtime, self.program_line = None, Runtime.STOPPED, 0
        self._watchdog, self._interrupted = None, None

    def set_watchdog(self, name: Any, frequency: float, action: Any) -> None:
        """Watch an input field while the program runs (`rtde_set_watchdog`)."""
        kind = str(name).split("_")
        if str(action) not in ("pause", "stop", "ignore") or kind[0] != "input":
            raise ScriptError(f"rtde_set_watchdog: {name!r}, {action!r} are not allowed")
        period = 1.0 / frequency if frequency > 0.0 else 0.0
        self._watchdog = Watchdog(str(name), period, str(action).lower(), self.cycles * DT)

    def _check_watchdog(self, written: Mapping[str, Any]) -> None:
        dog, now = self._watchdog, self.cycles * DT
        if dog is None or self.runtime != Runtime.PLAYING or dog.period == 0.0:
            return
        if dog.field in written:
            dog.last = now
        elif now - dog.last > dog.period + DT / 2.0 and dog.action != "ignore":
            self.say(f"RTDE watchdog: {dog.field} was not written for {now - dog.last:.3f} s")
            if dog.action == "stop":
                self.stop()
            else:
                self.pause()

    # Safety ----------------------------------------------------------------------------------

    def protective_stop(self, why: str) -> None:
        """Stop and pause the program, as after a collision or a broken limit."""
        if self.safety_mode in MOVES:
            self.safety_mode = SafetyMode.PROTECTIVE_STOP
            self._stopped_at = self.cycles * DT
            self._halt_for_safety(why)
            code, level = robot_messages.PROTECTIVE_STOP, robot_messages.WARNING
            self.announce(robot_messages.error_code(code, why[:500], level))

    def unlock(self, at_once: bool = False) -> bool:
        """Unlock a protective stop; False: too early."""
        if self.safety_mode != SafetyMode.PROTECTIVE_STOP:
            return True
        if not at_once and self.cycles * DT - self._stopped_at < UNLOCK_AFTER:
            return False
        self._normal()
        return True

    def safeguard(self, on: bool) -> None:
        """A person enters or leaves the guarded space."""
        if on and self.safety_mode in MOVES:
            self.safety_mode = SafetyMode.SAFEGUARD_STOP
            self._halt_for_safety("safeguard stop")
        elif not on and self.safety_mode == SafetyMode.SAFEGUARD_STOP:
            self._normal()

    def fall_to(self, mode: SafetyMode, why: str) -> None:
        """Emergency stop, violation or fault: the arm brakes, then its power is cut."""
        self.safety_mode = mode
        self.stop()
        self._halt_for_safety(why)
        if self.robot_mode != RobotMode.RUNNING:
            self._power_down()

    def release(self) -> bool:
        """Release the emergency stop, or restart the safety system; the power stays off.

        Returns:
            Whether there was something to release.
        """
        dead = self.safety_mode in DEAD
        if dead:
            self._normal()
        return dead

    def reduce(self, on: bool) -> None:
        """Reduced mode: other safety limits, which the emulator does not know, are in force."""
        self.reduced = on
        if self.safety_mode in MOVES:
            self._normal()

    def guide(self, on: bool, qd: Sequence[float] = (0.0,) * 6) -> None:
        """Free-drive: a hand moves the joints [rad/s]."""
        if on and not self.ready_for_program:
            return
        self.guided, self.hand_qd = on, [float(value) for value in qd]

    def _normal(self) -> None:
        self.safety_mode = SafetyMode.REDUCED if self.reduced else SafetyMode.NORMAL

    def _halt_for_safety(self, why: str) -> None:
        self.say(f"{self.safety_mode.name.lower().replace('_', ' ')}: {why}")
        if self.program is not None:
            self.runtime = Runtime.PAUSED
            self._interrupted = self.motion.command
        self.guided = False
        self._brake()

    def _hold(self) -> None:
        """Without power the brakes stop the arm and hold it."""
        if self.motion.at_rest:
            self.motion.lock()
            return
        if self.motion.command is not REST:
            self.motion.brake()
        self.motion.step()

    def _brake(self) -> None:
        self.motion.brake()
        self._braking = True

    # Power -----------------------------------------------------------------------------------

    def power_on(self) -> None:
        """Power the motors; the brakes stay on."""
        if self.robot_mode == RobotMode.POWER_OFF and self.safety_mode not in DEAD:
            self.robot_mode = RobotMode.POWER_ON
            self._power_goal, self._power_at = RobotMode.IDLE, self.cycles * DT + POWER_TIME

    def release_brakes(self) -> None:
        """Release the brakes; powers the motors first where they are off."""
        self.power_on()
        if self.robot_mode == RobotMode.IDLE:
            self._power_at = self.cycles * DT + POWER_TIME
        if self.robot_mode in (RobotMode.POWER_ON, RobotMode.IDLE):
            self._power_goal = RobotMode.RUNNING

    def engage_brakes(self) -> None:
        """Put the brakes on, with power; the program ends."""
        if self.robot_mode == RobotMode.RUNNING:
            self.stop()
            self.robot_mode = RobotMode.IDLE
            self._power_at = math.inf

    def power_off(self) -> None:
        """Cut the power of the motors; the program ends."""
        self.stop()
        self._power_down()

    def _power_down(self) -> None:
        if self.robot_mode != RobotMode.BOOTING:
            self.robot_mode = RobotMode.POWER_OFF
            self._power_at = math.inf
        self.guided = False

    def _switch_power(self) -> None:
        if self.cycles * DT < self._power_at or self.robot_mode == RobotMode.RUNNING:
            return
        now, goal = self.robot_mode, self._power_goal
        if now == RobotMode.BOOTING:
            self.robot_mode, self._power_at = RobotMode.POWER_OFF, math.inf
        elif now == RobotMode.POWER_ON:
            self.robot_mode, self._power_at = RobotMode.IDLE, self.cycles * DT + POWER_TIME
        elif now == RobotMode.IDLE and goal == RobotMode.RUNNING and self.safety_mode not in DEAD:
            self.robot_mode = RobotMode.RUNNING

    # Settings --------------------------------------------------------------------------------

    def say(self, text: str) -> None:
        """A message to the controller's log and its primary clients."""
        self.messages.append(text[:500])
        self.said += 1
        self.announce(robot_messages.text(text[:500]))

    def announce(self, message: RobotMessage) -> None:
        """A message to the primary clients alone."""
        self.announced.append(message)
        self.announcements += 1

    def _fail(self, what: str, error: ScriptError) -> None:
        """A program was refused or has failed: people and primary clients are told."""
        self.say(f"{what}{error}")
        line = re.search(r"line (\d+)", str(error))
        column, text = (
            (error.column, error.code) if isinstance(error, UnknownName) else (0, str(error))
        )
        number = int(line[1]) if line else 0
        self.announce(robot_messages.runtime_exception(number, column, text[:500]))

    def set_payload(self, mass: float, cog: Sequence[float]) -> None:
        """Payload: mass [kg] and centre of gravity in the flange's frame [m]."""
        self.payload, self.payload_cog = mass, [float(value) for value in cog]

    def set_digital(self, place: int, value: bool) -> None:
        """Switch a standard digital output, 0 to 7."""
        if not 0 <= place <= 7:
            raise ScriptError(f"digital output {place} must be from 0 to 7")
        self.digital_outputs = self.digital_outputs & ~(1 << place) | int(value) << place


def _registers() -> dict[str, list[Any]]:
    empty = {"BOOL": False, "INT32": 0, "DOUBLE": 0.0}
    return {kind: [empty[code]] * count for kind, (count, code) in REGISTERS.items()}
