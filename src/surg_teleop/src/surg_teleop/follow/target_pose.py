"""The pose that an arm is told to be at, from one sample of the hand to the next.

The hand is latched anew with every sample, so that nothing that changes meanwhile makes a step: a
new scale, a lock, an endoscope that moves, a wall. What the hand wants is never cut: a wish that
is further away than one command may go is followed at the fastest allowed pace, and a hand that
jumps is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_teleop.follow.arm_view import ArmView, Pose, tip_pose, virtual_joints
from surg_teleop.follow.hand_mapping import Mapping
from surg_teleop.leaders.handle_roll import Handle
from surg_teleop.leaders.leader import LeaderSample
from surg_teleop.playback.motion_file import (
    JUMP_SLACK,
    JUMP_SPEED,
    ROLL_JUMP_SLACK,
    ROLL_JUMP_SPEED,
)
from surg_teleop.playback.workspace_fit import Workspace

Array = NDArray[np.float64]

KEEP_ALIVE = 0.05
"""[s] A hand that says nothing new has its last wish repeated: half of the arm's time-out."""
LEAD = 0.02
"""[m] A stick drives the target no further ahead of the arm than this."""


class HandJumpError(ValueError):
    """A hand that jumps: by how much, and what is allowed."""


@dataclass(frozen=True)
class StepLimits:
    """How far a command may be from the last, as the arm's gate counts it.

    The gate counts from receipt to receipt in whole cycles, so a command that is late makes the
    next one early: half the slack and two cycles are kept for that.

    Attributes:
        velocity: [m/s].
        slack: [m].
        roll_velocity: [rad/s].
        roll_slack: [rad].
        longest: Time since the last command beyond which no further step is granted [s].
        period: Control cycle [s].
    """

    velocity: float
    slack: float
    roll_velocity: float
    roll_slack: float
    longest: float
    period: float = 0.002

    def allowed(self, since: float) -> tuple[float, float]:
        """Largest step of the tip [m] and of the roll [rad], a time [s] after the last command."""
        counted = max(0.0, min(since, self.longest) - 2.0 * self.period)
        return (
            self.velocity * counted + self.slack / 2.0,
            self.roll_velocity * counted + self.roll_slack / 2.0,
        )


class Target:
    """What the hand wants since an engagement, and what the arm has been told of it.

    Args:
        workspace: Where the tip may be commanded.
        limits: How far one command may be from the last.
        arm: The arm at the engagement: its set-point is where everything begins.
        sample: The hand at the engagement.
        now: Steady clock [s].
    """

    def __init__(
        self,
        workspace: Workspace,
        limits: StepLimits,
        arm: ArmView,
        sample: LeaderSample,
        now: float,
    ) -> None:
        self._workspace, self._limits = workspace, limits
        self._handle = Handle(sample.pose) if sample.pose is not None else None
        self._stamp = sample.stamp
        self._told, self._told_roll, self._told_at = arm.p_set, arm.roll_set, now
        self._new = False
        self.wanted: Array = arm.p_set
        """(3,) tip that the hand wants, in the rcm frame [m]."""
        self.roll = arm.roll_set
        """Roll that it wants [rad]."""
        self.wall = ""
        """The wall of the workspace that holds the wish; empty: none."""

    def hand(
        self, sample: LeaderSample, scale: float, R_RV: Array, *, moves: bool, rolls: bool
    ) -> None:
        """A position leader: the hand's motion since the last sample moves the wish.

        Args:
            sample: The newest sample; one that was seen before changes nothing.
            scale: Arm metres per metre of the hand.
            R_RV: (3, 3) the view in the rcm frame, now.
            moves: False: the tip stays.
            rolls: False: the roll stays.

        Raises:
            HandJumpError: The hand has jumped; the wish is as it was.
        """
        pose = sample.pose
        if pose is None or not sample.stamp > self._stamp:
            return
        if self._handle is None:
            self._handle = Handle(pose)
        p_before, roll_before = self._handle.p, self._handle.roll
        self._handle.move(pose)
        since, self._stamp = sample.stamp - self._stamp, sample.stamp
        self._refuse_jump(self._handle.p - p_before, self._handle.roll - roll_before, since)
        mapping = Mapping(scale, p_before, roll_before, self.wanted, self.roll, R_RV)
        if moves:
            self._want(mapping.position(self._handle.p))
        if rolls:
            self.roll = mapping.roll(self._handle.roll)
        self._new = True

    def stick(
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
        """A rate leader: its wish is integrated, inside the workspace and not far from the arm.

        Args:
            sample: The newest sample.
            dt: Since the last tick [s].
            factor: Of its rates.
            R_RV: (3, 3) the view in the rcm frame, now.
            arm: Where the arm is.
            moves: False: the tip stays.
            rolls: False: the roll stays.
        """
        rate = sample.rate
        if rate is None:
            return
        before, roll_before = self.wanted, self.roll
        if moves:
            step = self._stick_step(rate.v_V, rate.spherical, factor * dt, R_RV)
            longest = self._limits.velocity * dt
            length = float(np.linalg.norm(step))
            if length > longest:
                step = step * (longest / length)
            ahead = self.wanted - arm.p_set
            if float(np.linalg.norm(ahead + step)) <= max(LEAD, float(np.linalg.norm(ahead))):
                self._want(self.wanted + step)
        if rolls:
            turn = self._limits.roll_velocity * dt
            self.roll += min(max(factor * rate.roll * dt, -turn), turn)
        self._new = self._new or self.roll != roll_before or bool((self.wanted != before).any())

    def due(self, now: float) -> bool:
        """Whether the arm should be told now."""
        return self._new or now - self._told_at >= KEEP_ALIVE

    def command(self, now: float) -> Pose:
        """The next command: as near to the wish as one step may go."""
        step, turn = self._limits.allowed(now - self._told_at)
        left, left_roll = self.wanted - self._told, self.roll - self._told_roll
        length = float(np.linalg.norm(left))
        if length > step:
            # Between two points of the workspace the straight line may leave it near the trocar.
            self._told, _ = self._workspace.nearest(self._told + left * (step / length))
        else:
            self._told = self.wanted
        self._told_roll += min(max(left_roll, -turn), turn)
        self._told_at, self._new = now, False
        return tip_pose(self._told, self._told_roll)

    def _want(self, p: Array) -> None:
        self.wanted, self.wall = self._workspace.nearest(p)

    def _stick_step(self, v_V: Array, spherical: Array | None, dt: float, R_RV: Array) -> Array:
        if spherical is None:
            step: Array = R_RV @ v_V * dt
            return step
        yaw, pitch, insertion, _ = virtual_joints(self.wanted, 0.0) + dt * np.append(spherical, 0.0)
        s = [math.sin(yaw) * math.cos(pitch), math.sin(pitch), math.cos(yaw) * math.cos(pitch)]
        to: Array = insertion * np.array(s)
        return to - self.wanted

    def _refuse_jump(self, move: Array, turn: float, since: float) -> None:
        length = float(np.linalg.norm(move))
        most = JUMP_SPEED * since + JUMP_SLACK
        if not length <= most:
            raise HandJumpError(
                f"jumped by {1e3 * length:.0f} mm in {1e3 * since:.0f} ms (allowed: "
                f"{1e3 * most:.0f} mm)"
            )
        most = ROLL_JUMP_SPEED * since + ROLL_JUMP_SLACK
        if not abs(turn) <= most:
            raise HandJumpError(
                f"rolled by {math.degrees(abs(turn)):.0f} degrees in {1e3 * since:.0f} ms "
                f"(allowed: {math.degrees(most):.0f})"
            )
