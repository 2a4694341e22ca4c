"""The shipped controller on an arm that lags, for faults with exact deadlines: no ROS, no clock.

The arm is ``lagging_arm``'s, which goes on with the last command it got. ``Bench`` counts cycles
and looks at every command that leaves.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import surg_core
from helpers.control.lagging_arm import SOURCE, TICK, LagPlant
from surg_cli.host import paths
from surg_core import Motion, MotionCommand, Reason, State, StateCommand

Array = NDArray[np.float64]
STRANGER = 2
STREAMS = ("servo_cp", "servo_cv", "servo_jp", "servo_jv")


@lru_cache
def shipped(cell: str) -> surg_core.Arm:
    """PSM1 of a shipped cell."""
    return surg_core.load_cell(paths.ROOT / "cells" / cell).arms["PSM1"]


class Bench(LagPlant):
    """A controller, an arm that lags, and an operator.

    Args:
        seed: Of whatever the operator draws.
        cell: Folder below cells/.
        robot: In place of the cell's robot.
        home: Where the arm stands, in place of the robot's home [rad].
        depth: Tip beyond the trocar [m]; None: the cell's trocar.
        options: Of the controller.

    Attributes:
        jerked: Largest change of a joint's command in one cycle, over its limit (must be <= 1).
        out: What the last cycle decided.
    """

    def __init__(
        self,
        seed: int = 0,
        cell: str = "sim_ur5e",
        robot: surg_core.RobotConfig | None = None,
        home: Array | None = None,
        depth: float | None = None,
        **options: Any,
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.arm = arm = shipped(cell)
        self.robot = arm.robot if robot is None else robot
        self.limits = arm.limits
        self.controller = surg_core.Controller(
            arm.chain, self.robot, arm.limits, arm.instrument, arm.tool, **options
        )
        super().__init__(self.robot.home if home is None else home)
        self._command = np.zeros_like(self.q)
        self.cycles = 0
        self.jerked = 0.0
        self.jaw = 0.4
        X_BF = arm.chain.forward(self.q)
        p_tip = X_BF[:3, :3] @ np.array(arm.tool.p_FTip) + X_BF[:3, 3]
        s = X_BF[:3, :3] @ np.array(arm.tool.s_F)
        self.p_trocar = np.array(arm.trocar.p_BRcm) if depth is None else p_tip - depth * s
        self.out = self.step()

    # --- one cycle --------------------------------------------------------------------------

    def step(self, *commands: MotionCommand, **faulty: Any) -> surg_core.Outputs:
        """One cycle.

        Args:
            commands: Of this cycle.
            faulty: What the controller is given in place of the truth, by the name of an argument
                of ``Controller.step``.
        """
        told: dict[str, Any] = {"q": self.q, "qd": self.qd, "jaw": self.jaw, **faulty}
        self.out = self.controller.step(commands=list(commands), **told)
        command = np.array(self.out.qd_command)
        assert np.all(np.isfinite(command)) and np.all(np.isfinite(self.out.twist_command))
        # Behind a gap the arm may have been stopped: what counts is what was measured.
        before = told["qd"] if faulty.get("elapsed", 0) > 5 * TICK else self._command
        change = np.abs(command - before) / (np.array(self.robot.acceleration) * TICK)
        self.jerked = max(self.jerked, float(change.max()))
        self._command = command
        self.jaw += float(np.clip(self.out.jaw_set - self.jaw, -0.01, 0.01))
        self.freeze(1)
        self.cycles += 1
        return self.out

    def freeze(self, ticks: int) -> None:
        """Time passes and the controller does nothing: the arm goes on as it was told last."""
        for _ in range(ticks):
            self.obey(self._command)

    # --- an operator ------------------------------------------------------------------------

    def start(self) -> Bench:
        """Teach the trocar, enable, home, and let the arm come onto the pivot."""
        assert self.controller.set_rcm(self.p_trocar) == Reason.NONE
        self.step()
        assert self.controller.request(StateCommand.ENABLE) == Reason.NONE
        assert self.controller.request(StateCommand.HOME) == Reason.NONE
        for _ in range(10):
            self.step()
        return self

    def tip(self) -> Array:
        """Measured tip in the rcm frame (3,) [m]."""
        R_RB = np.asarray(self.controller.X_BR)[:3, :3].T
        return R_RB @ (self.out.p_BTip - self.out.p_BRcm)

    def setpoint(self) -> Array:
        """Set-point of the tip in the rcm frame (3,) [m]."""
        R_RB = np.asarray(self.controller.X_BR)[:3, :3].T
        return R_RB @ (self.out.p_set - self.out.p_BRcm)

    def direction(self, lateral: bool = False) -> Array:
        """A random unit vector (3,) in the rcm frame."""
        u = self.rng.normal(size=3)
        if lateral:
            u[2] = 0.0
        return u / np.linalg.norm(u)

    def wander(self, kind: str, speed: float) -> Callable[[], MotionCommand]:
        """A stream from where the arm is: each call gives the next command.

        Args:
            kind: One of ``STREAMS``.
            speed: Of the tip, reached within 50 ms [m/s].
        """
        u, begin = self.direction(), self.setpoint()
        joints, v = np.array(self.out.virtual_set), np.zeros(4)
        v[:3] = speed * u
        v[:2] /= np.linalg.norm(begin)
        along = 0.0
        k = 0

        def advance() -> MotionCommand:
            nonlocal along, k
            k += 1
            along += min(1.0, k / 25) * TICK
            if kind == "servo_cp":
                p = begin + speed * along * u
                return command("servo_cp", p=p, rotation=[0, 0, 0, 1])
            if kind == "servo_cv":
                return command("servo_cv", p=speed * u)
            if kind == "servo_jp":
                return command("servo_jp", joints=joints + along * v)
            return command("servo_jv", joints=v)

        return advance

    def warm_up(self, kind: str | None = None, speed: float | None = None) -> Any:
        """Stream for a random while; returns what streams."""
        kind = str(self.rng.choice(STREAMS)) if kind is None else kind
        speed = float(self.rng.uniform(0.02, 0.05)) if speed is None else speed
        stream = self.wander(kind, speed)
        for _ in range(int(self.rng.integers(60, 150))):
            self.step(stream())
            assert self.out.state == State.ENABLED, self.out.reason
            assert self.out.verdicts[0].reason == Reason.NONE, self.out.verdicts[0].reason
        assert np.abs(self.out.qd_command).max() > 1e-4
        return stream

    def rest(self, most: int = 400, **faulty: Any) -> int:
        """Cycles until the command is zero for good; fails where it never is."""
        for n in range(most):
            if not np.any(self.step(**faulty).qd_command):
                return n
        raise AssertionError(f"still moving after {most} cycles: {self.out.qd_command}")

    def flange_speed(self) -> float:
        """Of the arm in the last cycle [m/s]."""
        before = self.arm.chain.forward(self.q - self.qd * TICK)
        return float(np.linalg.norm(self.arm.chain.forward(self.q)[:3, 3] - before[:3, 3])) / TICK

    def commanded_flange_speed(self) -> float:
        """That the last command asks for, by the twist that goes with it [m/s]."""
        return float(np.linalg.norm(self.out.twist_command[:3]))

    def deviation(self) -> float:
        """Distance of the true shaft from the trocar [m]."""
        X_BF = self.arm.chain.forward(self.q)
        p = X_BF[:3, :3] @ np.array(self.arm.tool.p_FTip) + X_BF[:3, 3]
        s = X_BF[:3, :3] @ np.array(self.arm.tool.s_F)
        d = self.p_trocar - p
        return float(np.linalg.norm(d - (d @ s) * s))


def command(motion: str, source: int = SOURCE, **values: Any) -> MotionCommand:
    """A command by the name of its topic."""
    return MotionCommand(getattr(Motion, motion.upper()), source, **values)


def force(f_B: Any, where: str = "tip_force") -> dict[str, Any]:
    """For ``Bench.step``: a measured force [N] in the base frame."""
    return {"readings": surg_core.Readings(**{where: surg_core.ForceSample(f_B)})}
