"""The target of a hand that holds a straight instrument: its tip, and the roll about its shaft.

An instrument in a trocar has four degrees of freedom: of a handle's orientation only the roll about
its own axis is used, by swing–twist. The swing, its pitch and yaw, is ignored, so there is nothing
to align.
"""

from __future__ import annotations

import math

import numpy as np

from surg_core.arm_view import ArmView, Array, TipPose
from surg_core.hand.leader_sample import HandlePose, LeaderSample
from surg_core.transforms import CONJUGATE, multiply_quaternions
from surg_teleop.follow.target_pose import StepLimits, TargetPose
from surg_teleop.playback.workspace_fit import Workspace

MIN_TWIST = 0.17
"""|cos(swing / 2)| of a hand must exceed this, 160 degrees of swing: near the singularity a little
tremor is much roll. A hand that has turned so far is latched anew."""


class Handle:
    """A live hand: its position, and its roll since it was latched, sample by sample."""

    def __init__(self, pose: HandlePose) -> None:
        self._latched = pose.q_VH
        self._offset = 0.0
        self.p: Array = pose.p_VH
        """(3,) newest position in V [m]."""
        self.roll = 0.0
        """Roll since the first sample, unwrapped [rad]."""

    def move(self, pose: HandlePose) -> None:
        """The next sample."""
        self.p = pose.p_VH
        _, _, z, w = multiply_quaternions(self._latched * CONJUGATE, pose.q_VH).tolist()
        turn = math.remainder(2.0 * math.atan2(z, w) - (self.roll - self._offset), math.tau)
        if math.hypot(z, w) < MIN_TWIST:
            # The swing is too large to tell the roll: go on from here, the roll as it is.
            self._latched, self._offset = pose.q_VH, self.roll
            return
        self.roll += turn


class StraightTarget(TargetPose):
    """See the module."""

    def __init__(
        self,
        workspace: Workspace,
        limits: StepLimits,
        arm: ArmView,
        sample: LeaderSample,
        now: float,
    ) -> None:
        super().__init__(workspace, limits, arm, sample, now)
        self._handle = Handle(sample.pose) if sample.pose is not None else None
        self._sent, self._sent_roll = arm.p_set, arm.roll_set

    def follow_hand(
        self, sample: LeaderSample, scale: float, R_RV: Array, *, moves: bool, rolls: bool
    ) -> None:
        """See ``TargetPose``."""
        pose = sample.pose
        if pose is None or not sample.stamp > self._stamp:
            return
        if self._handle is None:
            self._handle = Handle(pose)
        p_before, roll_before = self._handle.p, self._handle.roll
        self._handle.move(pose)
        since, self._stamp = sample.stamp - self._stamp, sample.stamp
        self._check_jump(self._handle.p - p_before, self._handle.roll - roll_before, since)
        if moves:
            self._set_target(self.wanted + scale * ((self._handle.p - p_before) @ R_RV.T))
        if rolls:  # not scaled: a turn of the hand is a turn of the instrument
            self.roll += self._handle.roll - roll_before
        self._new = True

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
        """See ``TargetPose``."""
        rate = sample.rate
        if rate is None:
            return
        before, roll_before = self.wanted, self.roll
        if moves:
            step = self._rate_step(rate, factor, dt, R_RV)
            if self._stays_near(arm, step):
                self._set_target(self.wanted + step)
        if rolls:
            turn = self._limits.roll_velocity * dt
            self.roll += min(max(factor * rate.roll * dt, -turn), turn)
        self._new = self._new or self.roll != roll_before or bool((self.wanted != before).any())

    def command(self, now: float) -> TipPose:
        """See ``TargetPose``."""
        step, turn = self._limits.allowed(now - self._sent_at)
        left, left_roll = self.wanted - self._sent, self.roll - self._sent_roll
        length = float(np.linalg.norm(left))
        if length > step:
            # Near the trocar the straight line between two points may leave the workspace.
            within = self._workspace.from_here(self._sent)
            self._sent, _ = within.nearest(self._sent + left * (step / length))
        else:
            self._sent = self.wanted
        self._sent_roll += min(max(left_roll, -turn), turn)
        self._sent_at, self._new = now, False
        return TipPose(self._sent, self._sent_roll)

    def _set_target(self, p: Array) -> None:
        self.wanted, self.wall = self._workspace.from_here(self.wanted).nearest(p)
