"""The commanded tip pose, from one leader sample to the next.

The mapping is latched anew with every sample, so a change of scale, lock or view, or a wall of the
workspace, never makes a step. A target further away than one command may go is approached at the
largest allowed step. A leader that jumps is refused. An arm that was stopped on its way out may be
shallower than the workspace: from there the target only goes deeper.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from surg_core import Limits
from surg_core.arm_view import ArmView, Array, TipPose
from surg_core.contract import SECOND_NS, TICK_NS
from surg_core.hand.leader_sample import HandRate, LeaderSample
from surg_core.transforms import virtual_tip
from surg_teleop.playback.motion_file import (
    JUMP_SLACK,
    JUMP_SPEED,
    ROLL_JUMP_SLACK,
    ROLL_JUMP_SPEED,
)
from surg_teleop.playback.workspace_fit import Workspace

KEEP_ALIVE = 0.05
"""[s] The last target is repeated after this: half of the arm's stream timeout."""
LEAD = 0.02
"""[m] A rate leader drives the target at most this far ahead of the arm."""


class HandJumpError(ValueError):
    """The leader has jumped; the message states by how much and what is allowed."""


@dataclass(frozen=True)
class StepLimits:
    """Largest step between two commands that the arm's gate accepts.

    The gate counts whole cycles between receipts, so a late command makes the next one early. Half
    the slack and two cycles are kept in reserve for that.
    """

    velocity: float  # [m/s]
    slack: float  # [m]
    roll_velocity: float  # [rad/s]
    roll_slack: float  # [rad]
    longest: float  # the step stops growing at this time since the last command [s]
    wrist_velocity: float = 0.0  # [rad/s]

    @classmethod
    def of(cls, limits: Limits, wrist_velocity: float = 0.0) -> StepLimits:
        """The steps that an arm with these limits accepts."""
        return cls(
            velocity=limits.tip_velocity,
            slack=limits.step_slack,
            roll_velocity=limits.roll_velocity,
            roll_slack=limits.step_roll_slack,
            longest=limits.step_dt_max,
            wrist_velocity=wrist_velocity,
        )

    def allowed(self, since: float) -> tuple[float, float]:
        """Largest step of the tip [m] and of the roll [rad], a time [s] after the last command."""
        counted = self._counted(since)
        return (
            self.velocity * counted + self.slack / 2.0,
            self.roll_velocity * counted + self.roll_slack / 2.0,
        )

    def allowed_wrist(self, since: float) -> float:
        """Largest turn of each joint of a wrist [rad], a time [s] after the last command."""
        return self.wrist_velocity * self._counted(since) + self.roll_slack / 2.0

    def _counted(self, since: float) -> float:
        return max(0.0, min(since, self.longest) - 2.0 * TICK_NS / SECOND_NS)


class TargetPose(ABC):
    """The target of the hand and the command on the way to it; starts at the arm's set-point."""

    def __init__(
        self,
        workspace: Workspace,
        limits: StepLimits,
        arm: ArmView,
        sample: LeaderSample,
        now: float,
    ) -> None:
        self._workspace, self._limits = workspace, limits
        self._stamp, self._sent_at, self._new = sample.stamp, now, False
        self.wanted: Array = arm.p_set
        """(3,) target of the tip, in the rcm frame [m]."""
        self.roll = arm.roll_set
        """Target of the roll [rad]."""
        self.wall = ""
        """The wall of the workspace that limits the target; empty: none."""

    @abstractmethod
    def follow_hand(
        self, sample: LeaderSample, scale: float, R_RV: Array, *, moves: bool, rolls: bool
    ) -> None:
        """Position control: move the target by the hand's motion, seen in R_RV (3, 3).

        Raises:
            HandJumpError: The hand has jumped; the target is unchanged.
        """

    @abstractmethod
    def follow_rate(
        self,
        sample: LeaderSample,
        dt: float,
        factor: float,
        R_RV: Array,
        arm: ArmView,
        *,
        moves: bool,
        rolls: bool,
    ) -> None:
        """Rate control: integrate over dt [s], inside the workspace and close to the arm."""

    @abstractmethod
    def command(self, now: float) -> TipPose:
        """The next command, as near to the target as one step may go."""

    def behind(self, arm: ArmView) -> tuple[float, float]:
        """How far the arm is behind the target: its tip [m], and the turn of its tool [rad]."""
        return float(np.linalg.norm(self.wanted - arm.p_set)), 0.0

    def due(self, now: float) -> bool:
        """Whether a command is due."""
        return self._new or now - self._sent_at >= KEEP_ALIVE

    def _rate_step(self, rate: HandRate, factor: float, dt: float, R_RV: Array) -> Array:
        """Step (3,) in the rcm frame [m] for a time [s], no faster than the arm's limit."""
        step: Array = R_RV @ rate.v_V * (factor * dt)
        if rate.spherical is not None:
            moved = factor * dt * np.append(rate.spherical, 0.0)
            yaw, pitch, insertion, _ = TipPose(self.wanted, 0.0).joints + moved
            step = virtual_tip(yaw, pitch, insertion) - self.wanted
        longest = self._limits.velocity * dt
        length = float(np.linalg.norm(step))
        return step * (longest / length) if length > longest else step

    def _stays_near(self, arm: ArmView, step: Array) -> bool:
        """Whether a step of a rate leader leaves the target close to the arm; NaN does not."""
        ahead = self.wanted - arm.p_set
        return float(np.linalg.norm(ahead + step)) <= max(LEAD, float(np.linalg.norm(ahead)))

    def _check_jump(self, move: Array, turn: float, since: float) -> None:
        length = float(np.linalg.norm(move))
        allowed = JUMP_SPEED * since + JUMP_SLACK
        if not length <= allowed:
            raise HandJumpError(
                f"jumped by {1e3 * length:.0f} mm in {1e3 * since:.0f} ms (allowed: "
                f"{1e3 * allowed:.0f} mm)"
            )
        allowed = ROLL_JUMP_SPEED * since + ROLL_JUMP_SLACK
        if not abs(turn) <= allowed:
            raise HandJumpError(
                f"rolled by {math.degrees(abs(turn)):.0f} degrees in {1e3 * since:.0f} ms "
                f"(allowed: {math.degrees(allowed):.0f})"
            )
