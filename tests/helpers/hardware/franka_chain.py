"""Controller, driver and emulated Franka arm in one thread on a made-up clock.

All of ours is in it: the driver with its datagrams, the adapter, the shaper. The same figures on
any machine.
"""

from __future__ import annotations

import importlib
import socket
import sys
import types
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.hardware import fake_libfranka
from helpers.hardware.emulated_cell import deviation, tip_of
from helpers.hardware.emulated_chain import controller_of
from helpers.hardware.fake_libfranka import Arm
from surg_cli.host import paths
from surg_core import MotionCommand, Readings, RobotCondition
from surg_emulators.franka import franka_kinematics
from surg_emulators.franka.franka_robots import FER, FR3
from surg_emulators.franka.generator_motion import DT
from surg_hardware import adapter_driver, arm_driver, link_node, robot_link
from surg_hardware import driver_datagrams as wire
from surg_hardware.driver_checkup import Heard
from surg_hardware.franka import joint_limits
from surg_hardware.franka.franka_adapter import FrankaAdapter

ROBOTS = {"panda": FER, "fr3": FR3}
LIMITS = {"panda": joint_limits.PANDA, "fr3": joint_limits.FR3}


def adapter(name: str, robot: Arm, options: Any, patch: pytest.MonkeyPatch) -> FrankaAdapter:
    """The FR3's adapter, for a Panda with its limits, on an emulated arm."""
    patch.setitem(sys.modules, "pylibfranka", fake_libfranka.pylibfranka(robot))
    patch.delitem(sys.modules, "surg_hardware.franka.fr3_adapter", raising=False)
    fr3 = importlib.import_module("surg_hardware.franka.fr3_adapter").Driver
    kind = type("Driver", (fr3,), {"model": name, "limits": LIMITS[name]})
    made: FrankaAdapter = kind("127.0.0.1", options)
    return made


class Chain:
    """A bundled emulated cell with its arm at home, started.

    Args:
        name: ``panda`` or ``fr3``.
        patch: Puts the made-up clock in.
    """

    def __init__(self, name: str, patch: pytest.MonkeyPatch) -> None:
        self.arm = surg_core.load_cell(paths.CELLS / f"emulated_{name}").arms["PSM1"]
        self.robot = Arm(ROBOTS[name], self.arm.robot.home.tolist())
        self.core = self.robot.core
        options = dict(self.arm.link_settings)
        self._cycles = self._held = self._paused = self._silent = 0
        clock = types.SimpleNamespace(
            monotonic=lambda: DT * self._cycles,
            time_ns=lambda: round(1e9 * DT * self._cycles),
            sleep=lambda seconds: None,
        )
        patch.setattr(arm_driver, "time", clock)
        patch.setattr(adapter_driver, "time", clock)
        patch.setattr(robot_link, "SETTLED", 0.1)
        self._node, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._node.setblocking(False)
        settings = link_node.driver_settings(self.arm)
        made = adapter(name, self.robot, options, patch)
        self.driver = adapter_driver.AdapterDriver(settings, theirs, made)
        self.driver._connect_first()
        self.controller = controller_of(self.arm)
        self._heard = Heard()
        self.run(600)  # longer than no motion must have been commanded
        self.ask("start")
        self.run(20)

    def ask(self, word: str) -> None:
        """As a person does."""
        enabled = self.out.state == surg_core.State.ENABLED
        self._node.send(wire.RequestDatagram(word, enabled).pack())

    def hold_driver(self, cycles: int) -> None:
        """Let the driver stand still for the next cycles of the robot."""
        self._held = cycles

    def hold_robot(self, cycles: int) -> None:
        """Let the robot and its clock stand still for the next cycles, as a simulator may."""
        self._paused = cycles

    def step(self, *commands: MotionCommand) -> surg_core.Outputs:
        """One cycle of the controller, two of the robot."""
        for _ in range(2):
            self._cycles += 1
            if self._paused > 0:
                self._paused -= 1
                self._silent += 1
            elif self._held > 0:
                self._held -= 1
                self._silent += 1
                self.robot.client.wait(1)
            else:
                self._silent = 0
                self.driver._turn()
        self._heard.read(self._node, DT * self._cycles)
        assert self.state is not None
        condition = RobotCondition(int(self.state.status.condition))
        if self._silent * DT > link_node.SILENCE:  # says the node
            condition = RobotCondition.OFFLINE
        self.out = self.controller.step(
            np.array(self.state.q),
            np.array(self.state.qd),
            list(commands),
            jaw=0.0,
            readings=Readings(condition=condition),
        )
        stamp = round(1e9 * DT * self._cycles)
        self._node.send(wire.CommandDatagram(stamp, tuple(self.out.qd_command.tolist())).pack())
        return self.out

    def run(self, cycles: int) -> surg_core.Outputs:
        """Some cycles without a command to the controller."""
        for _ in range(cycles):
            self.step()
        return self.out

    @property
    def state(self) -> wire.StateDatagram | None:
        """The newest of the driver."""
        return self._heard.newest

    @property
    def notices(self) -> list[str]:
        """The driver's sentences."""
        return self._heard.notices

    @property
    def identity(self) -> wire.IdentityDatagram | None:
        """What the robot said of itself."""
        return self._heard.identity

    @property
    def joints(self) -> list[float]:
        """Of the emulated arm itself [rad]."""
        return list(self.core.motion.q)

    @property
    def flange(self) -> np.ndarray:
        """By the emulated arm's own joints and its maker's table (4, 4)."""
        return np.array(franka_kinematics.flange(self.core.motion.q))

    @property
    def tip(self) -> np.ndarray:
        """Position in the base [m]."""
        return tip_of(self.arm, self.flange)

    @property
    def deviation(self) -> float:
        """Of the shaft from the trocar [m]."""
        return float(deviation(self.arm, self.flange))
