"""Motion player, core controller and a lagging arm in one process: no ROS, no MuJoCo.

The plant is what an industrial arm's joint servos look like from outside: two ticks of delay and a
first-order lag of 8 ms, the same in every joint.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import surg_core
from surg_core.arm_view import ArmCommands, ArmState, ArmView, JawRange
from surg_core.wrist_joints import WristView
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.playback.motion_file import read_motion
from surg_teleop.playback.motion_plan import make_plan
from surg_teleop.playback.motion_player import Mode, MotionPlayer, PlayerStage
from surg_teleop.playback.workspace_fit import Workspace

TICK_NS = 2_000_000
TICK = 0.002
LAG = 0.008
DELAY = 2
SOURCE = 1


@dataclass(frozen=True)
class Run:
    """What came out, over the ticks in which the motion was streamed.

    Attributes:
        stage: How the operator ended.
        reason: Why it gave up.
        refused: ArmCommands that the controller refused.
        rcm_error: (n,) distance of the shaft from the trocar [m].
        tip_error: (n,) distance of the tip from the plan, lag removed [m].
        lag: The lag that was removed [s].
        unscaled: Share of ticks in which no limit slowed the arm.
        limited_by: Which limits did.
        planned: Length of the plan [s].
        played: Time of the plan that was reached [s].
        slowed: By how much longer than planned it took [s].
        end_error: Distance of the tip from the plan's end [m].
        first_refusal: Time in the plan [s] and cause; None: nothing was refused.
    """

    stage: PlayerStage
    reason: str
    refused: int
    rcm_error: NDArray[np.float64]
    tip_error: NDArray[np.float64]
    lag: float
    unscaled: float
    limited_by: frozenset[str]
    planned: float
    played: float
    slowed: float
    end_error: float
    first_refusal: tuple[float, str] | None


class LagPlant:
    """Joints with two ticks of delay and a first-order lag of 8 ms.

    Attributes:
        q: (n,) positions [rad].
        qd: (n,) mean velocities over the last tick [rad/s].
    """

    def __init__(self, q: NDArray[np.float64]) -> None:
        self.q = np.array(q, dtype=float)
        self.qd = np.zeros_like(self.q)
        self._servo, self._pending = self.q, deque([self.qd] * DELAY)

    def obey(self, command: NDArray[np.float64]) -> None:
        """One tick with joint velocities (n,) [rad/s]."""
        self._pending.append(np.array(command))
        self._servo = self._servo + self._pending.popleft() * TICK
        before, self.q = self.q, self.q + (self._servo - self.q) * (1.0 - np.exp(-TICK / LAG))
        self.qd = (self.q - before) / TICK


class LaggingArm:
    """The core controller and what it drives, tick by tick.

    Args:
        arm: Of a cell.
        law: Of the controller.
        feedback_gain: Of the controller; negative: the robot's own.

    Attributes:
        controller: The controller.
        out: What its last step decided.
        tick: Ticks so far.
    """

    def __init__(
        self,
        arm: surg_core.Arm,
        law: surg_core.Law = surg_core.Law.EXACT,
        feedback_gain: float = -1.0,
    ) -> None:
        self.arm, self.tick = arm, 0
        self.controller = surg_core.Controller(
            arm.chain,
            arm.robot,
            arm.limits,
            arm.instrument,
            arm.tool,
            law=law,
            feedback_gain=feedback_gain,
        )
        self.controller.set_rcm(arm.trocar.p_BRcm)
        self._plant = LagPlant(arm.robot.home)

    def step(self, commands: ArmCommands, source: int = SOURCE) -> surg_core.Outputs:
        """One cycle with the commands of one sender, then one tick of the plant."""
        self.tick += 1
        orders = asked(commands, self.controller, source)
        self.out = self.controller.step(self._plant.q, self._plant.qd, orders)
        self._plant.obey(self.out.qd_command)
        return self.out

    def view(self, names: dict[int, str] | None = None) -> ArmView:
        """What a sender sees of the last cycle.

        Args:
            names: Senders' names by number.
        """
        return view_of(self.arm, self.controller, self.out, self.tick, names)


def view_of(
    arm: surg_core.Arm,
    controller: surg_core.Controller,
    out: surg_core.Outputs,
    tick: int,
    names: dict[int, str] | None = None,
) -> ArmView:
    """What a sender sees of a cycle; ``names`` are the senders', by number."""
    R_BR = np.asarray(controller.X_BR)[:3, :3]
    holder = (names or {}).get(out.source, "")
    return ArmView(
        stamp_ns=tick * TICK_NS,
        state=ArmState(int(out.state)),
        homed=out.homed,
        busy=out.busy,
        reason=surg_core.reason_name(out.reason),
        refused=out.refused,
        accepted=out.accepted,
        p_BSet=out.p_set,
        p_BTip=out.p_BTip,
        p_BRcm=out.p_BRcm,
        R_BR=R_BR,
        roll_set=out.roll_set,
        jaw_set=out.jaw_set,
        holder=holder,
        stream=holder if out.motion == surg_core.Motion.SERVO_CP else "",
        R_WB=np.asarray(arm.X_WB)[:3, :3],
        received=tick * TICK,
        depth=out.depth,
        wrist=None if out.wrist is None else WristView.of(out.wrist),
    )


def play(
    cell: Path,
    motion: Path,
    mode: Mode,
    duration: float | None = None,
    feedback_gain: float = -1.0,
    law: surg_core.Law = surg_core.Law.EXACT,
) -> Run:
    """Plays a motion into the cell's PSM1."""
    arm = surg_core.load_cell(cell).arms["PSM1"]
    limits = arm.limits
    plan = make_plan(
        read_motion(motion),
        Workspace(limits.depth_slow, limits.depth_max, limits.cone),
        1.0,
        duration,
    )
    jaw = JawRange(arm.instrument.jaw_min, arm.instrument.jaw_max)
    operator = MotionPlayer(plan, mode, jaw, StepLimits.of(limits))
    plant = LaggingArm(arm, law, feedback_gain)
    rcm_error, tips, times, scales, limited = [], [], [], [], set()
    commands = ArmCommands()
    for _ in range(1, 200_000):
        out = plant.step(commands)
        view = plant.view()
        if operator.stage is PlayerStage.PLAY:
            rcm_error.append(out.rcm_error)
            tips.append(view.p_tip)
            times.append(operator.clock)
            scales.append(out.scale)
            if out.scale < 1.0:
                limited.add(out.limited_by)
        if operator.done:
            break
        commands = operator.tick(view)
    wanted, _ = plan.path(np.array(times))
    lag, error = _without_lag(np.array(tips).reshape(-1, 3), wanted)
    return Run(
        stage=operator.stage,
        reason=operator.reason,
        refused=operator.refused,
        rcm_error=np.array(rcm_error),
        tip_error=error,
        lag=lag,
        unscaled=float(np.mean(np.array(scales) >= 1.0)) if scales else 0.0,
        limited_by=frozenset(limited),
        planned=plan.duration,
        played=operator.clock,
        slowed=operator.slowed_ns / 1e9,
        end_error=float(np.linalg.norm(view.p_tip - plan.at(plan.duration)[0])),
        first_refusal=operator.first_refusal,
    )


def asked(
    commands: ArmCommands, controller: surg_core.Controller, source: int = SOURCE
) -> list[surg_core.MotionCommand]:
    """The motion commands of a sender; its words and its claim go to the controller at once."""
    motion, command = surg_core.Motion, surg_core.MotionCommand
    if commands.state is not None:
        controller.request(getattr(surg_core.StateCommand, commands.state.upper()))
    if commands.claim:
        controller.claim(source)
    found = []
    for kind, pose in ((motion.MOVE_CP, commands.move_cp), (motion.SERVO_CP, commands.servo_cp)):
        if pose is not None:
            found.append(command(kind, source, p=pose.p, rotation=pose.q))
    if commands.servo_jp is not None:
        joints, wrist = np.split(commands.servo_jp, [4])
        turned = wrist if len(wrist) else None
        found.append(command(motion.SERVO_JP, source, joints=joints, wrist=turned))
    if commands.jaw is not None:
        found.append(command(motion.JAW_SERVO_JP, source, jaw=commands.jaw))
    if commands.hold:
        found.append(command(motion.HOLD, source))
    return found


def _without_lag(
    tips: NDArray[np.float64], wanted: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64]]:
    """The delay in ticks that explains the most, and the error that is left."""
    best = (0.0, np.full(1, np.inf))
    for ticks in range(min(40, len(tips) - 1)):
        error = np.linalg.norm(tips[ticks:] - wanted[: len(tips) - ticks], axis=1)
        if np.mean(error**2) < np.mean(best[1] ** 2):
            best = (ticks * TICK, error)
    return best
