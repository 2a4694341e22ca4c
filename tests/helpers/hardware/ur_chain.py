"""Link, program and emulated UR arm in one thread on a fake clock: exact in cycles."""

from __future__ import annotations

import math
from collections.abc import Sequence

from helpers.hardware.emulated_ur import Client
from surg_hardware.conditions import Condition
from surg_hardware.emulators.ur.joint_motion import DT
from surg_hardware.emulators.ur.rtde_server import RtdeSession
from surg_hardware.emulators.ur.ur_controller import UrController
from surg_hardware.robot_link import Command, RobotLink, Settings, Status
from surg_hardware.ur import urscript
from surg_hardware.ur.rtde import INPUTS, OUTPUTS, Decoder, Recipe
from surg_hardware.ur.ur_driver import robot_state

DEAD_MAN, STOP = 0.04, 20.0
REST = (0.0,) * 6


class Chain:
    """The driver's work without its process: one state, one command per cycle.

    Attributes:
        controller: The emulated arm.
        link: The link.
        status: What the link says.
        sent: The velocities of this cycle [rad/s]; None: nothing was sent.
    """

    def __init__(self) -> None:
        self.controller = UrController()
        client = Client(RtdeSession(self.controller))
        self._session = client.session
        number = client.set_up(OUTPUTS, INPUTS)
        types = ",".join(client.types).encode()
        self._outputs = Recipe.of(OUTPUTS, b"\x01" + types)
        answer = bytes([number]) + ",".join(client.inputs[number]).encode()
        self._inputs = Recipe.of(INPUTS, answer)
        self._decoder = Decoder()
        limits = Settings((math.pi,) * 6, (40.0,) * 6, DEAD_MAN, STOP)
        self.link = RobotLink(limits)
        self.status: Status | None = None
        self.sent: tuple[float, ...] | None = None
        self._command: Command | None = None
        self._now = 0.0

    @property
    def condition(self) -> Condition:
        """What the link says of the robot."""
        return Condition.OFFLINE if self.status is None else self.status.condition

    def cycle(self, qd: Sequence[float] | None = REST) -> None:
        """One cycle of robot, link and controller.

        Args:
            qd: The controller's velocities [rad/s]; None: it sends nothing.
        """
        self._now += DT
        self.controller.advance()
        ((_, payload),) = self._decoder.add(self._session.output())
        values = self._outputs.unpack(payload)
        assert values is not None
        if qd is not None:
            self._command = Command(tuple(qd), round(1e9 * self._now), self._now)
        step = self.link.step(robot_state(values), self._command, self._now)
        self.status, self.sent = step.status, step.qd
        if step.qd is not None:
            assert self._session.receive(self._inputs.pack(step.number, *step.qd)) == b""
        self.controller.execute()

    def cycles(self, count: int, qd: Sequence[float] | None = REST) -> None:
        """Several cycles with one command."""
        for _ in range(count):
            self.cycle(qd)

    def start(self) -> int:
        """Start the robot; returns the cycles until the link drives it."""
        refusal = self.link.start(False, math.inf, self._now)
        assert refusal == "", refusal
        assert self.controller.run_script(urscript.follow_program(STOP))
        for count in range(100):
            if self.condition is Condition.ACTIVE:
                return count
            self.cycle()
        raise AssertionError(self.status)
