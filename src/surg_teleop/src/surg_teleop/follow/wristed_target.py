"""The target of a hand that holds a wristed instrument: its tip follows all six motions.

A turn of the hand turns the tip about the same axis in the picture, by the same angle. Nothing has
to be aligned: an engagement keeps the angle between hand and tool. No leader here turns itself into
the tool's orientation, as a motorized one does, and a hand that had to find it would move blindly.
"""

from __future__ import annotations

import math

import numpy as np

from surg_core.arm_view import ArmView, Array, TipPose
from surg_core.hand.leader_sample import LeaderSample
from surg_core.transforms import (
    quaternion_xyzw_to_matrix,
    rotation_of,
    rotation_vector,
    turn_between,
)
from surg_teleop.follow.target_pose import StepLimits, TargetPose
from surg_teleop.follow.wristed_tip import WristedTip, WristRange
from surg_teleop.playback.workspace_fit import Workspace

SLOW_WRIST = math.radians(10.0)
"""[rad] A joint that is farther behind its target is reported."""
LEAD_TURN = 0.2
"""[rad] A rate leader turns the target at most this far ahead of the arm."""


class WristedTarget(TargetPose):
    """As :class:`TargetPose`; ``wanted`` is the tip, and the way to it is one of the joints."""

    def __init__(
        self,
        workspace: Workspace,
        limits: StepLimits,
        arm: ArmView,
        sample: LeaderSample,
        now: float,
        wrist: WristRange,
    ) -> None:
        super().__init__(workspace, limits, arm, sample, now)
        self._wrist = wrist
        self._before = sample.pose
        self._joints = self._sent_joints = wrist.of_arm(arm)

    def follow_hand(
        self, sample: LeaderSample, scale: float, R_RV: Array, *, moves: bool, rolls: bool
    ) -> None:
        """Position control: move the tip by the hand's motion, and turn it by the hand's turn."""
        pose = sample.pose
        if pose is None or not sample.stamp > self._stamp:
            return
        before = self._before or pose
        since, self._stamp, self._before = sample.stamp - self._stamp, sample.stamp, pose
        move, turn = pose.p_VH - before.p_VH, turn_between(before.q_VH, pose.q_VH)
        self._check_jump(move, float(np.linalg.norm(turn)), since)
        self._move(scale * (R_RV @ move) * moves, (R_RV @ turn) * rolls)

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
        """Rate control: turns about the axes of the picture, or a roll about the tool's own."""
        rate = sample.rate
        if rate is None:
            return
        step = self._rate_step(rate, factor, dt, R_RV) * moves
        if not self._stays_near(arm, step):
            step = np.zeros(3)
        if rate.tilt is None:
            omega = self._tool()[:, 2] * rate.roll
        else:
            omega = R_RV @ np.append(rate.tilt, rate.roll)
        turn = factor * dt * omega * rolls
        size, longest = float(np.linalg.norm(turn)), self._limits.roll_velocity * dt
        if size > longest:
            turn = turn * (longest / size)
        ahead = self._angle_to(arm, np.zeros(3))
        if ahead > LEAD_TURN and self._angle_to(arm, turn) > ahead:
            turn = np.zeros(3)
        if step.any() or turn.any():
            self._move(step, turn)

    def behind(self, arm: ArmView) -> tuple[float, float]:
        """Of tip [m] and tool [rad]."""
        return super().behind(arm)[0], self._angle_to(arm, np.zeros(3))

    def command(self, now: float) -> TipPose:
        """The next command: all joints go the same part of their ways."""
        since = now - self._sent_at
        step, roll = self._limits.allowed(since)
        wrist = self._limits.allowed_wrist(since)
        sent, wanted = self._sent_joints, self._joints
        way, turns = wanted.centre - sent.centre, wanted.turns - sent.turns
        shares = [float(np.linalg.norm(way)) / step, *np.abs(turns) / [roll, wrist, wrist]]
        part = 1.0 / max(1.0, *shares)
        if part < 1.0:
            within = self._workspace.from_here(sent.centre)
            centre, _ = within.nearest(sent.centre + part * way)
            wanted = WristedTip(centre, sent.turns + part * turns)
        self._sent_joints, self._sent_at, self._new = wanted, now, False
        return self._wrist.pose(wanted)

    def _move(self, step: Array, turn: Array) -> None:
        joints, self.wall = self._wrist.moved(self._joints, step, turn, self._workspace)
        self._joints, self._new = joints, True
        pose = self._wrist.pose(joints)
        self.wanted, self.roll = pose.p, pose.roll
        slow = np.abs(joints.turns - self._sent_joints.turns).max() > SLOW_WRIST
        self.wall = self.wall or ("turning speed" if slow else "")

    def _tool(self) -> Array:
        R_RTip = self._wrist.pose(self._joints).R_RTip
        assert R_RTip is not None
        return R_RTip

    def _angle_to(self, arm: ArmView, turn: Array) -> float:
        """Angle between the arm's tool and the target, turned by a rotation vector (3,) [rad]."""
        assert arm.wrist is not None
        R_RSet = quaternion_xyzw_to_matrix(arm.wrist.q_RSet)
        return float(np.linalg.norm(rotation_vector(rotation_of(turn) @ self._tool() @ R_RSet.T)))
