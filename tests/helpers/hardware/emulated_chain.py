"""Controller, link and emulated UR arm in one thread on a made-up clock: exact in cycles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import surg_core
from helpers.hardware import ur_chain
from helpers.hardware.emulated_cell import deviation, tip_of, ur_flange
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
from surg_emulators.ur.joint_motion import LAGS
from surg_emulators.ur.ur_controller import UrController
from surg_hardware import link_node
from surg_hardware.robot_link import Settings, Status

T = 0.002


def link_settings(arm: surg_core.Arm) -> Settings:
    """Of the link of an arm with hardware."""
    given = link_node.driver_settings(arm)
    return Settings(given.velocity, given.acceleration, given.dead_man, given.stop_deceleration)


def controller_of(arm: surg_core.Arm, law: Law = Law.EXACT) -> surg_core.Controller:
    """A controller of an arm, with its trocar."""
    controller = surg_core.Controller(
        arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool, law=law
    )
    controller.set_rcm(arm.trocar.p_BRcm)
    return controller


class Chain:
    """The bundled cell `emulated_ur5e` with its arm at home, started and enabled.

    ``lags``: of the emulated joints behind their targets [s]; ``cell``: another folder.
    """

    def __init__(
        self,
        law: Law = Law.EXACT,
        enabled: bool = True,
        lags: Sequence[float] = LAGS,
        cell: Path = paths.CELLS / "emulated_ur5e",
    ) -> None:
        self.arm = surg_core.load_cell(cell).arms["PSM1"]
        self.robot = UrController(q=self.arm.robot.home.tolist(), lags=lags)
        self.ur = ur_chain.Chain(link_settings(self.arm), self.robot)
        self.link, self.clock, self.law = self.ur.link, self.ur.clock, law
        self.obeys_commands = True  # False: the controller's commands are lost on their way
        self.moves = True  # False: the controller sees an arm that stands still
        self.controller = controller_of(self.arm, law)
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
        return self.ur.now

    @property
    def status(self) -> Status | None:
        """What the link says."""
        return self.ur.status

    def start(self) -> str:
        """As a person asks for it: the refusal, or nothing."""
        enabled = self.out.state == State.ENABLED
        return self.ur.ask_to_start(enabled, self.clock.known_for)

    def step(self, *commands: MotionCommand) -> surg_core.Outputs:
        """One cycle of all: the robot's state, the link's answer, the controller's next command."""
        state = self.ur.cycle(None)
        assert self.status is not None
        q, qd = np.array(state.q), np.array(state.qd)
        if not self.moves:
            q, qd = self.arm.robot.home, np.zeros(6)
        self.out = self.controller.step(
            q,
            qd,
            list(commands),
            jaw=0.0,
            readings=Readings(condition=RobotCondition(int(self.status.condition))),
        )
        if self.obeys_commands:
            self.ur.say([float(value) for value in self.out.qd_command])
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
    def joints(self) -> list[float]:
        """Of the emulated arm itself [rad]."""
        return list(self.robot.motion.actual_q)

    @property
    def flange(self) -> np.ndarray:
        """By the emulated arm's own joints and its maker's table, in our base (4, 4)."""
        return ur_flange(self.robot.motion.actual_q, self.robot.table)

    @property
    def tip(self) -> np.ndarray:
        """Position in the base [m]."""
        return tip_of(self.arm, self.flange)

    @property
    def deviation(self) -> float:
        """Of the shaft from the trocar [m]."""
        return float(deviation(self.arm, self.flange))
