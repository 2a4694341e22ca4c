"""An arm behind a controller: each joint with a lag of its own, a common delay, quantised encoders.

It knows nothing of the controller's model. What is judged is the plant's own motion.
"""

from __future__ import annotations

import collections
from typing import Any

import numpy as np

import surg_core
from helpers.control.fault_bench import shipped
from helpers.control.lagging_arm import TICK as T
from surg_core import Motion, MotionCommand, StateCommand

ROBOTS = ("sim_ur5e", "sim_panda")
STEP = 0.0005
"""Time of one step of the plant [s]."""
QUANTUM = 1e-5
"""Step of the encoders [rad]."""


class JointPlant:
    """A controller of a bundled cell and the arm that it moves, homed and enabled.

    Args:
        cell: Name of the cell.
        lags: First-order lag of each joint [s]; one for all joints, or (n,).
        delay: Time until a command reaches the joints [s].
        q: Joint positions at the start (n,) [rad]; the home posture where None.
    """

    def __init__(
        self,
        cell: str = "sim_ur5e",
        lags: float | np.ndarray = 0.008,
        delay: float = 0.004,
        q: np.ndarray | None = None,
    ) -> None:
        self.arm = arm = shipped(cell)
        self.controller = surg_core.Controller(
            arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool
        )
        self.most = np.asarray(arm.robot.acceleration)
        self.q = np.array(arm.robot.home if q is None else q, float)
        self.qd = np.zeros(len(self.q))
        self.lags = np.broadcast_to(lags, self.q.shape)
        self.waiting: collections.deque[tuple[float, np.ndarray]] = collections.deque()
        self.obeyed, self.time, self.delay = self.qd, 0.0, delay
        self.silent = False
        """Whether the link loses every command from now on."""
        self.heard = 0.0
        self.brakes: np.ndarray | None = None
        """Deceleration of each joint (n,) [rad/s^2] with which the robot stops by itself."""
        self.window = [self.qd] * (round(T / STEP) + 1)
        self.worst = 0.0
        """Largest acceleration of a joint, over its limit."""
        self.out: Any = None
        self.controller.set_rcm(np.asarray(arm.trocar.p_BRcm))

    def start(self) -> surg_core.Reason:
        """Home and enable; the reason if the controller refuses."""
        self.step()
        reason = self.controller.request(StateCommand.HOME)
        if reason == surg_core.Reason.NONE:
            reason = self.controller.request(StateCommand.ENABLE)
        self.step()
        return reason

    def measured(self) -> np.ndarray:
        """Joint positions in steps of the encoders (n,) [rad]."""
        return np.round(self.q / QUANTUM) * QUANTUM

    def step(self, *commands: MotionCommand, dt: float = T, q: Any = None, **state: Any) -> Any:
        """One cycle, then dt [s] of motion. ``q`` and ``state`` replace what is measured."""
        qd = state.pop("qd", self.qd)
        self.out = self.controller.step(
            self.measured() if q is None else q, qd, list(commands), **state
        )
        if not self.silent:
            self.waiting.append((self.time + self.delay, np.array(self.out.qd_command)))
        for _ in range(round(dt / STEP)):
            self._move()
        return self.out

    def _move(self) -> None:
        while self.waiting and self.waiting[0][0] <= self.time + 1e-9:
            self.obeyed, self.heard = self.waiting.popleft()[1], self.time
        if self.brakes is None and self.time - self.heard > self.arm.robot.tuning.dead_man:
            lead = self.arm.robot.tuning.stop_deceleration  # the link stops it along its path
            fast = np.abs(self.qd)
            self.brakes = fast * lead / max(fast.max(), 1e-9)
        if self.brakes is not None:
            self._brake()
            return
        keep = np.exp(-STEP / self.lags)
        away = self.qd - self.obeyed
        self.q = self.q + STEP * self.obeyed + away * self.lags * (1 - keep)
        self.qd = self.obeyed + keep * away
        self.time += STEP
        self.window = [*self.window[1:], self.qd]
        change = np.abs(self.qd - self.window[0]) / (STEP * (len(self.window) - 1))
        self.worst = max(self.worst, float((change / self.most).max()))

    def _brake(self) -> None:
        assert self.brakes is not None
        slower = np.sign(self.qd) * np.maximum(np.abs(self.qd) - STEP * self.brakes, 0.0)
        self.q, self.qd = self.q + 0.5 * STEP * (self.qd + slower), slower
        self.time += STEP

    def tip(self) -> np.ndarray:
        """The tip in the rcm frame (3,) [m], by the true joints."""
        X_BF = np.asarray(self.arm.chain.forward(self.q))
        X_BR = np.asarray(self.controller.X_BR)
        p_B = X_BF[:3, :3] @ np.asarray(self.arm.tool.p_FTip) + X_BF[:3, 3]
        return np.asarray(X_BR[:3, :3].T @ (p_B - X_BR[:3, 3]))

    def sweep(self, speed: float, seconds: float) -> None:
        """Follow ``sideways`` from the present time on."""
        begun = self.time
        while self.time - begun < seconds:
            self.step(sideways(speed, self.time - begun))


def sideways(speed: float, t: float) -> MotionCommand:
    """Where a sine of 0.5 Hz is at time t [s], whose fastest point has this speed [m/s]."""
    w = 2 * np.pi * 0.5
    return pose([speed / w * np.sin(w * t) * min(t, 1.0), 0.0, 0.12])


def pose(p: Any, **fields: Any) -> MotionCommand:
    """A sample of a pose stream to p (3,) [m] in the rcm frame."""
    motion = fields.pop("motion", Motion.SERVO_CP)
    return MotionCommand(motion, source=1, p=list(p), rotation=[0, 0, 0, 1], **fields)
