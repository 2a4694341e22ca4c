"""The simulator's tissue with an emulated UR in it: the drawn arm goes where the robot's joints go.

The controller hears and commands the emulated robot through its link, in the place of the
simulator's arm. The simulated joints follow the emulated ones in every step of the physics, however
the tissue pulls.
"""

from __future__ import annotations

import numpy as np

import surg_core
from helpers.hardware import ur_chain
from helpers.hardware.emulated_cell import deviation, ur_flange
from helpers.hardware.emulated_chain import T, link_settings
from surg_cli.host import paths
from surg_emulators.ur.ur_controller import UrController
from surg_sim.envs.cell_session import LAWS, CellSession
from surg_sim.physics.sim_arm import SUBSTEPS, ArmCommand, ArmLink
from surg_sim.physics.world import World

NAME = "PSM1"
CELL = paths.CELLS / "emulated_ur5e"


class EmulatedLink(ArmLink):
    """A world's link whose arm is an emulated robot, started by a person before the episode."""

    chain: ur_chain.Chain

    def __init__(self, world: World, arm: surg_core.Arm, settings: surg_core.Arm) -> None:
        self._arm, self._settings = arm, settings
        self.deviations: list[float] = []
        super().__init__(world.model, world.data, arm)

    def reset(self) -> None:
        """The robot at home, started; nothing has moved."""
        super().reset()
        robot = UrController(q=self._arm.robot.home.tolist())
        self.chain = ur_chain.Chain(link_settings(self._settings), robot)
        self.deviations.clear()
        self.chain.cycles(1100)
        assert self.chain.ask_to_start(False, self.chain.clock.known_for) == ""
        self.chain.cycles(20)
        self._state = self.chain.cycle()
        self._from = np.array(robot.motion.actual_q)
        self._part = 0

    @property
    def q(self) -> np.ndarray:
        """What the robot says of its joints [rad]."""
        return np.array(self._state.q)

    @property
    def qd(self) -> np.ndarray:
        """What the robot says of their velocities [rad/s]."""
        return np.array(self._state.qd)

    def accept(self, command: ArmCommand | None) -> None:
        """Hand the controller's velocities to the link, and let the robot run for one cycle."""
        assert command is not None and command.velocity is not None
        self._from, self._part = np.array(self.chain.controller.motion.actual_q), 0
        self.chain.say([float(value) for value in command.velocity])
        self._state = self.chain.cycle(None)
        assert self.chain.status is not None
        self.condition = surg_core.RobotCondition(int(self.chain.status.condition))
        q = self.chain.controller.motion.actual_q
        flange = ur_flange(q, self.chain.controller.table)
        self.deviations.append(float(deviation(self._arm, flange)))

    def substep(self) -> None:
        """Move the simulated joints to the emulated ones within one step of the physics."""
        self._part += 1
        end = np.array(self.chain.controller.motion.actual_q)
        goal = self._from + (end - self._from) * self._part / SUBSTEPS
        rate = (goal - self._data.qpos[self._qpos]) * SUBSTEPS / T
        self._data.qvel[self._qvel] = rate
        self._data.act[self._act] = self._data.qpos[self._qpos]
        self._data.ctrl[self._spring_ctrl] = rate
        self._data.ctrl[self._damper_ctrl] = rate


class EmulatedSession(CellSession):
    """A session whose PSM1 is an emulated UR5e with the settings of the cell `emulated_ur5e`."""

    link: EmulatedLink | None = None

    def _begin(self) -> None:
        arm = self.cell.arms[NAME]
        settings = surg_core.load_cell(CELL).arms[NAME]
        if self.link is None:
            self.link = EmulatedLink(self.world, arm, settings)
            self.world._members[NAME].link = self.link
            self.world.reset(self.seed)
        super()._begin()
        controller = surg_core.Controller(
            arm.chain,
            settings.robot,
            arm.limits,
            arm.instrument,
            arm.tool,
            law=LAWS[self.law],
            clearance=self._clearance[NAME],
        )
        controller.set_rcm(arm.trocar.p_BRcm)
        for fixture in arm.fixtures:
            controller.set_fixture(fixture)
        self.controllers[NAME] = controller
