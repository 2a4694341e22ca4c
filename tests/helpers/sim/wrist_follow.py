"""A simulated arm that follows poses of a hand; where its tip really was, by the simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import surg_core
from surg_core.contract import TICK
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.world import World

Array = NDArray[np.float64]
ARM = "PSM1"


@dataclass
class Followed:
    """One row per tick; poses (n, 4, 4) of the tool frame in the rcm frame."""

    hand: Array
    tip: Array
    deviation: Array  # (n,) [m] of the true shaft from the trocar
    refused: int

    def errors(self, skip: int = 250, most_late: int = 80) -> tuple[Array, Array]:
        """Distances [m] and angles [rad] to the hand, less the delay that makes them smallest."""
        best: tuple[Array, Array] | None = None
        for late in range(most_late):
            hand = self.hand[skip - late : len(self.hand) - late]
            tip = self.tip[skip:]
            far = np.linalg.norm(tip[:, :3, 3] - hand[:, :3, 3], axis=1)
            if best is None or np.sqrt(np.mean(far**2)) < np.sqrt(np.mean(best[0] ** 2)):
                best = far, angles(hand[:, :3, :3], tip[:, :3, :3])
        assert best is not None
        return best


def angles(a: Array, b: Array) -> Array:
    """Angles between rotations (n, 3, 3) [rad], (n,)."""
    off = np.einsum("nij,nij->n", a, b)
    return np.arccos(np.clip((off - 1.0) / 2.0, -1.0, 1.0))


class WristedArm:
    """A cell's arm in the simulator with its controller, homed and ENABLED."""

    def __init__(self, cell: surg_core.Cell) -> None:
        arm = cell.arms[ARM]
        self.arm, self.world = arm, World(cell, visuals=False)
        self.controller = surg_core.Controller(
            arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool
        )
        self.controller.set_rcm(arm.trocar.p_BRcm)
        self.step()
        for word in ("HOME", "ENABLE"):
            reason = self.controller.request(getattr(surg_core.StateCommand, word))
            assert reason == surg_core.Reason.NONE
        self.step()
        self._tip = self.world.model.body(f"{ARM}_{arm.instrument.tip_link}").id
        self._R_TipTool = self._body()[:3, :3].T  # the tool frame is the rcm frame at home

    def step(self, *commands: surg_core.MotionCommand) -> surg_core.Outputs:
        """One tick."""
        state = self.world.state(ARM)
        readings = surg_core.Readings(wrist=state.wrist, wrist_rate=state.wrist_velocity)
        out = self.controller.step(state.q, state.qd, list(commands), state.jaw, readings=readings)
        turned = None if out.wrist is None else out.wrist.command
        jaw = out.jaw_set if np.isfinite(out.jaw_set) else None
        self.world.step({ARM: ArmCommand(velocity=out.qd_command, jaw=jaw, wrist=turned)})
        return out

    def tip(self) -> Array:
        """The tool frame's true pose in the rcm frame, (4, 4)."""
        X_RTool = self._body()
        X_RTool[:3, :3] = X_RTool[:3, :3] @ self._R_TipTool
        return X_RTool

    def _body(self) -> Array:
        data, tip = self.world.data, self._tip
        X_WTip = surg_core.make_pose(data.xpos[tip], data.xmat[tip].reshape(3, 3))
        X_WR = np.asarray(self.arm.X_WB_stated) @ np.asarray(self.controller.X_BR)
        return np.asarray(np.linalg.inv(X_WR) @ X_WTip)

    def follow(self, hand: Callable[[float], Array], seconds: float, period: int = 5) -> Followed:
        """Follow ``hand(t)`` (4, 4), a pose relative to the tip's at the start, by servo_cp.

        Args:
            hand: Its motion; at 0 s the identity.
            seconds: How long [s].
            period: Ticks between two samples.
        """
        start = self.tip()
        hands, tips, deviations, refused = [], [], [], 0
        for tick in range(round(seconds / TICK)):
            moved = hand(tick * TICK)
            p, R = start[:3, 3] + moved[:3, 3], moved[:3, :3] @ start[:3, :3]
            wanted = surg_core.make_pose(p, R)
            commands = []
            if tick % period == 0:
                q = surg_core.matrix_to_quaternion_xyzw(wanted[:3, :3])
                servo = surg_core.Motion.SERVO_CP
                commands = [surg_core.MotionCommand(servo, 1, p=wanted[:3, 3], rotation=q)]
            out = self.step(*commands)
            refused += sum(v.reason != surg_core.Reason.NONE for v in out.verdicts)
            hands.append(wanted)
            tips.append(self.tip())
            deviations.append(self.world.truth(ARM).deviation)
        return Followed(np.array(hands), np.array(tips), np.array(deviations), refused)
