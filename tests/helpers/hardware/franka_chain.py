"""Controller, driver and emulated Franka arm in one thread on a made-up clock.

All of ours but the library is in it: the driver with its datagrams, the adapter, the shaper.
The same figures on any machine.
"""

from __future__ import annotations

import functools
import random
import socket
import types
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.hardware.emulated_franka import Client
from surg_cli.host import paths
from surg_core import Law, MotionCommand, Readings, RobotCondition
from surg_emulators.franka import franka_kinematics
from surg_emulators.franka.franka_controller import FrankaController, RobotMode
from surg_emulators.franka.franka_robots import FER, FR3
from surg_emulators.franka.generator_motion import DT
from surg_hardware import adapter_driver, arm_driver, link_node, robot_link
from surg_hardware import driver_datagrams as wire
from surg_hardware.driver_checkup import Heard
from surg_hardware.franka import joint_limits
from surg_hardware.franka.franka_adapter import FrankaAdapter, MotionEnded
from surg_hardware.robot_adapter import AdapterError

ROBOTS = {"panda": FER, "fr3": FR3}
LIMITS = {"panda": joint_limits.PANDA, "fr3": joint_limits.FR3}


class CoreAdapter(FrankaAdapter):
    """The adapter on the emulator's core.

    Attributes:
        loss: Share of the commands that are lost.
        raw: Whether commands pass without the shaper.
        sluggish: Share of its last value in the acceleration that the robot reports; a real arm
            reports the newest one alone.
    """

    def __init__(self, name: str, core: FrankaController, options: Any) -> None:
        self.model, self.limits = name, LIMITS[name]
        super().__init__("127.0.0.1", options)
        self.core, self.client = core, Client(core)
        assert self.client.connect() == "success"
        self.loss, self.raw, self._random = 0.0, False, random.Random(1)
        self.sluggish, self._reported = 0.0, np.zeros(7)

    def connect(self) -> None:
        """Connected from the beginning."""

    def close(self) -> None:
        """It stays."""

    def _read(self) -> Any:
        self.client.wait(1)
        core, motion = self.core, self.core.motion
        if self._moving and core.mode is not RobotMode.MOVE:
            raise MotionEnded
        share = 1.0 - self.sluggish
        self._reported = self.sluggish * self._reported + share * np.array(motion.ddq_d)
        names = {error.name: True for error in core.errors | core.reflex_reason}
        errors = types.SimpleNamespace(**names)
        return types.SimpleNamespace(
            time=types.SimpleNamespace(to_sec=functools.partial(float, DT * core.number)),
            robot_mode=types.SimpleNamespace(name=core.mode.name.title().replace("_", "")),
            current_errors=errors,
            last_motion_errors=errors,
            q=list(motion.q),
            q_d=list(motion.q_d),
            dq=list(motion.dq),
            dq_d=list(motion.dq_d),
            ddq_d=self._reported.tolist(),
            O_F_ext_hat_K=list(core.wrench),
            O_T_EE=list(franka_kinematics.flange(motion.q).T.ravel()),
            F_T_EE=list(np.eye(4).ravel()),
            m_total=0.0,
            F_x_Ctotal=[0.0] * 3,
            control_command_success_rate=core.success_rate,
        )

    def recover(self) -> str:
        """The answer comes later."""
        self.client.ask("automatic_error_recovery")
        return ""

    def _begin(self) -> None:
        if self.client.move() != "started":
            raise AdapterError(f"the robot does not move in the mode {self.core.mode.name}")

    def _write(self, velocities: Sequence[float], finished: bool) -> None:
        if self._random.random() >= self.loss:
            self.core.receive(self.client.datagram(list(velocities), last=finished))

    def send(self, qd: Sequence[float]) -> None:
        """As the controller commands it, where the shaper is off."""
        if self.raw and self._moving:
            self._answered = True
            self._write(qd, False)
        else:
            super().send(qd)


class Chain:
    """A bundled emulated cell with its arm at home, started.

    Args:
        name: ``panda`` or ``fr3``.
        patch: Puts the made-up clock in.
    """

    def __init__(self, name: str, patch: pytest.MonkeyPatch) -> None:
        self.arm = surg_core.load_cell(paths.CELLS / f"emulated_{name}").arms["PSM1"]
        self.core = FrankaController(ROBOTS[name], q=self.arm.robot.home.tolist())
        self.adapter = CoreAdapter(name, self.core, dict(self.arm.link_settings))
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
        self.driver = adapter_driver.AdapterDriver(settings, theirs, self.adapter)
        self.driver._connect_first()
        arm = self.arm
        self.controller = surg_core.Controller(
            arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool, law=Law.EXACT
        )
        self.controller.set_rcm(arm.trocar.p_BRcm)
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
                self.adapter.client.wait(1)
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
        X = self.flange
        return np.array(X[:3, :3] @ self.arm.tool.p_FTip + X[:3, 3])

    @property
    def deviation(self) -> float:
        """Of the shaft from the trocar [m]."""
        away = self.arm.trocar.p_BRcm - self.tip
        s = self.flange[:3, :3] @ self.arm.tool.s_F
        return float(np.linalg.norm(away - (away @ s) * s))
