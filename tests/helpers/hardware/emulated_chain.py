"""Controller, link and emulated UR arm in one thread on a made-up clock: exact in cycles.

The bytes between link and robot are RTDE's. Not in it: sockets, the driver's loop, ROS.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import surg_core
from helpers.hardware.emulated_ur import Client
from surg_cli.host import paths
from surg_core import (
    Law,
    Motion,
    MotionCommand,
    Readings,
    Reason,
    RobotCondition,
    State,
    StateCommand,
)
from surg_hardware import link_node
from surg_hardware.emulators.ur.dh_kinematics import frames
from surg_hardware.emulators.ur.rtde_server import RtdeSession
from surg_hardware.emulators.ur.ur_controller import UrController
from surg_hardware.robot_clock import RobotClock
from surg_hardware.robot_link import Command, RobotLink, Settings, Status
from surg_hardware.ur import urscript
from surg_hardware.ur.rtde import INPUTS, OUTPUTS
from surg_hardware.ur.ur_driver import robot_state

TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""From ROS's base to UR's own."""
T = 0.002


class Chain:
    """The bundled cell `emulated_ur5e` with its arm at home, started and enabled."""

    def __init__(self, law: Law = Law.EXACT, enabled: bool = True) -> None:
        self.arm = surg_core.load_cell(paths.CELLS / "emulated_ur5e").arms["PSM1"]
        self.robot = UrController(q=self.arm.robot.home.tolist())
        self._client = Client(RtdeSession(self.robot))
        self._inputs = self._client.set_up(OUTPUTS, INPUTS)
        given = link_node.driver_settings(self.arm)
        self.link = RobotLink(
            Settings(given.velocity, given.acceleration, given.dead_man, given.stop_deceleration)
        )
        self._stop_deceleration = given.stop_deceleration
        self.clock = RobotClock()
        self.law, self.cycle = law, 0
        self.obeys_commands = True  # False: the controller's commands are lost on their way
        self.moves = True  # False: the controller sees an arm that stands still
        self.status: Status | None = None
        self._command: Command | None = None
        self.controller = surg_core.Controller(
            self.arm.chain,
            self.arm.robot,
            self.arm.limits,
            self.arm.instrument,
            self.arm.tool,
            law=law,
        )
        self.controller.set_rcm(self.arm.trocar.p_BRcm)
        self.x, self.depth = 0.0, 0.0
        self.out = self.run(1100)
        if enabled:
            assert self.start() == ""
            self.run(20)
            for word in (StateCommand.HOME, StateCommand.ENABLE):
                assert self.controller.request(word) == Reason.NONE, word
            self.run(20)
            assert self.out.state == State.ENABLED
            self.depth = float(np.linalg.norm(self.out.p_set - self.out.p_BRcm))

    @property
    def now(self) -> float:
        """Our clock [s]."""
        return T * self.cycle

    def start(self) -> str:
        """As a person asks for it: the refusal, or nothing."""
        enabled = self.out.state == State.ENABLED
        refusal = self.link.start(enabled, self.clock.known_for, self.now)
        if not refusal:
            assert self.robot.run_script(urscript.follow_program(self._stop_deceleration))
        return refusal

    def step(self, *commands: MotionCommand) -> surg_core.Outputs:
        """One cycle of all: the robot's state, the link's answer, the controller's next command."""
        self.cycle += 1
        self.robot.advance()
        values = self._values(self._client.state())
        state = robot_state(values)
        self.clock.arrived(state.time, self.now)
        step = self.link.step(state, self._command, self.now)
        if step.qd is not None:
            self._client.send(self._inputs, step.number, *step.qd)
        self.robot.execute()
        self.status = step.status
        q, qd = np.array(state.q), np.array(state.qd)
        if not self.moves:
            q, qd = self.arm.robot.home, np.zeros(6)
        self.out = self.controller.step(
            q,
            qd,
            list(commands),
            jaw=0.0,
            readings=Readings(condition=RobotCondition(int(step.status.condition))),
        )
        if self.obeys_commands:
            sent = tuple(float(value) for value in self.out.qd_command)
            self._command = Command(sent, round(1e9 * self.now), self.now)
        return self.out

    def run(self, cycles: int) -> surg_core.Outputs:
        """Some cycles without a command to the controller."""
        for _ in range(cycles):
            self.step()
        return self.out

    def stream(self, speed: float) -> surg_core.Outputs:
        """Sideways at a speed [m/s]."""
        self.x += speed * T
        p = [self.x, 0.0, self.depth]
        return self.step(MotionCommand(Motion.SERVO_CP, 1, p=p, rotation=[0, 0, 0, 1]))

    @property
    def flange(self) -> np.ndarray:
        """Of the emulated arm's own joints and its maker's table, in our base (4, 4)."""
        return np.array(TURN @ frames(self.robot.motion.actual_q, self.robot.table)[-1])

    @property
    def tip(self) -> np.ndarray:
        """Position in the base [m]."""
        X = self.flange
        return np.array(X[:3, :3] @ self.arm.tool.p_FTip + X[:3, 3])

    @property
    def deviation(self) -> float:
        """Of the shaft from the trocar [m]."""
        away = self.arm.trocar.p_BRcm - self.tip
        s = self.flange[:3, :3] @ self.arm.tool.s_F
        return float(np.linalg.norm(away - (away @ s) * s))

    @staticmethod
    def _values(state: dict[str, Any]) -> dict[str, tuple[float, ...]]:
        return {k: tuple(v) if isinstance(v, list) else (v,) for k, v in state.items()}
