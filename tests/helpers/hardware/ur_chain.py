"""Link, program and emulated UR arm in one thread on a fake clock: exact in cycles.

The bytes between link and robot are RTDE's. Not in it: sockets, the driver's loop, ROS.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from helpers.hardware.emulated_ur import Client
from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.rtde_server import RtdeSession
from surg_emulators.ur.ur_controller import UrController
from surg_hardware.arm_driver import STALE
from surg_hardware.conditions import NOT_NUMBERS, Condition
from surg_hardware.driver_process import finite
from surg_hardware.robot_clock import RobotClock
from surg_hardware.robot_link import Command, RobotLink, RobotState, Settings, Status
from surg_hardware.ur import urscript
from surg_hardware.ur.rtde import INPUTS, OUTPUTS, Decoder, Recipe
from surg_hardware.ur.ur_states import SetValues, robot_state

DEAD_MAN, STOP = 0.04, 20.0
REST = (0.0,) * 6
SETTINGS = Settings((math.pi,) * 6, (40.0,) * 6, DEAD_MAN, STOP)


class Chain:
    """The driver's work without its process: one state, one command per cycle.

    Attributes:
        controller: The emulated arm.
        link: The link.
        clock: The robot's time on ours.
        command: The controller's newest one.
        status: What the link says.
        sent: The velocities of this cycle [rad/s]; None: nothing was sent.
        silence: Cycles since the last state, while none comes; None: they come. Set it to 0 for a
            stalled network, and `driver_runs` to False for a driver that is frozen or dead.
        driver_runs: Whether the driver does.
        dashboard: Whether the robot obeys its dashboard server; False: it is in local control.
    """

    def __init__(
        self, settings: Settings = SETTINGS, controller: UrController | None = None
    ) -> None:
        self.controller = controller or UrController()
        self._connect()
        self.silence: int | None = None
        self.driver_runs = True
        self._down = 0  # cycles until the robot answers again
        self._stop_deceleration = settings.stop_deceleration
        self.link, self.clock = RobotLink(settings), RobotClock()
        self.status: Status | None = None
        self.sent: tuple[float, ...] | None = None
        self.command: Command | None = None
        self.dashboard = True
        self._count = 0
        self._set = SetValues()

    def _connect(self) -> None:
        client = Client(RtdeSession(self.controller))
        self._session = client.session
        number = client.set_up(OUTPUTS, INPUTS)
        types = ",".join(client.types).encode()
        self._outputs = Recipe.of(OUTPUTS, b"\x01" + types)
        answer = bytes([number]) + ",".join(client.inputs[number]).encode()
        self._inputs = Recipe.of(INPUTS, answer)
        self._decoder = Decoder()

    @property
    def condition(self) -> Condition:
        """What the link says of the robot."""
        return Condition.OFFLINE if self.status is None else self.status.condition

    @property
    def now(self) -> float:
        """Our clock [s]."""
        return DT * self._count

    def say(self, qd: Sequence[float]) -> None:
        """A command of the controller [rad/s]."""
        self.command = Command(tuple(qd), round(1e9 * self.now), self.now)

    def reboot(self, cycles: int) -> None:
        """The robot's controller starts again, and does not answer for some cycles."""
        self.controller.boot()
        self._down = cycles

    def cycle(self, qd: Sequence[float] | None = REST) -> RobotState:
        """One cycle of robot and link.

        Args:
            qd: The controller's velocities [rad/s]; None: it sends nothing.

        Returns:
            The newest state of the robot.
        """
        self._count += 1
        self.controller.advance()
        if self._down > 0:
            self._offline()
            return self._state
        if self.silence is not None:
            self._hold()
            return self._state
        ((_, payload),) = self._decoder.add(self._session.output())
        values = self._outputs.unpack(payload)
        assert values is not None
        state = robot_state(values)
        if not finite(state.q):
            self.status, self.sent = self.link.lost(NOT_NUMBERS), None
            self.controller.execute()
            return self._state
        self._state = state
        if not self.link.active:
            self._set.know(values)
        elif change := self._set.change(values):
            self.link.end(change)
        self.clock.arrived(state.time, self.now)
        if qd is not None:
            self.say(qd)
        step = self.link.step(state, self.command, self.now)
        self.status, self.sent = step.status, step.qd
        if step.qd is not None:
            assert self._session.receive(self._inputs.pack(step.number, *step.qd)) == b""
        if step.end_program and self.dashboard:
            self.controller.stop()
        self.controller.execute()
        return state

    def _offline(self) -> None:
        """One cycle in which no state comes."""
        self._down -= 1
        self.status, self.sent = self.link.lost(), None
        self.controller.execute()
        if self._down == 0:
            self._connect()
            self.clock.reset()

    def _hold(self) -> None:
        """One cycle without a state: a stalled network, or a driver that does not run."""
        assert self.silence is not None
        self._session.output()  # too late when it comes: only the newest state counts
        self.silence += 1
        if self.silence * DT > STALE and self.status is not None:
            lost = replace(self.status, condition=Condition.OFFLINE)  # says the node
            self.status = self.link.lost() if self.driver_runs else lost
        self.controller.execute()

    def cycles(self, count: int, qd: Sequence[float] | None = REST) -> None:
        """Several cycles with one command."""
        for _ in range(count):
            self.cycle(qd)

    def ask_to_start(self, enabled: bool, known_for: float) -> str:
        """As a person asks for it: the refusal, or nothing."""
        refusal = self.link.start(enabled, known_for, self.now)
        if not refusal:
            assert self.controller.run_script(urscript.follow_program(self._stop_deceleration))
        return refusal

    def start(self) -> int:
        """Start the robot; returns the cycles until the link drives it."""
        refusal = self.ask_to_start(False, math.inf)
        assert refusal == "", refusal
        for count in range(100):
            if self.condition is Condition.ACTIVE:
                return count
            self.cycle()
        raise AssertionError(self.status)
