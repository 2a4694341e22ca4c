"""One engagement: from the moment the arm starts to follow its leader until it is let go."""

from __future__ import annotations

import math

from surg_core.arm_view import ArmCommands, ArmView, TipPose
from surg_core.hand.leader_sample import LeaderSample
from surg_teleop.follow.jaw_follower import JawFollower
from surg_teleop.follow.straight_target import StraightTarget
from surg_teleop.follow.target_pose import HandJumpError, TargetPose
from surg_teleop.follow.teleop_types import (
    DEFAULT_SCALE,
    GRACE,
    MAX_LAG,
    MAX_TURN_LAG,
    Array,
    ControlMode,
    Notice,
    Reason,
    TeleopSettings,
)
from surg_teleop.follow.wristed_target import WristedTarget

AGAIN = "press and release the clutch, or press enable"
"""The operator's acts that start an engagement."""


class DisengagedError(Exception):
    """The engagement has ended; ``notice`` says why."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.notice = Notice(reason, f"let go: {text}; {AGAIN}")


class Engagement:
    """Starts at the arm's set-point, so an engagement never makes a step."""

    def __init__(
        self, settings: TeleopSettings, now: float, sample: LeaderSample, arm: ArmView
    ) -> None:
        self._settings, self._began = settings, now
        self._obeyed = False
        self._jaw: JawFollower | None = None
        self._target = _target(settings, now, sample, arm)

    def first_command(self) -> TipPose:
        """The set-point."""
        return self._target.command(self._began)

    def follow(
        self,
        now: float,
        dt: float,
        sample: LeaderSample,
        arm: ArmView,
        R_WV: Array,
        *,
        mode: ControlMode,
        scale: float,
        moves: bool,
        rolls: bool,
        commands: ArmCommands,
    ) -> Notice:
        """Follow the leader for one tick, `dt` after the last [s], in the view R_WV (3, 3).

        Returns:
            The wall of the workspace that limits the target, if one does.

        Raises:
            DisengagedError: The arm does not obey or lags, or the hand has jumped.
        """
        target = self._target
        if not self._obeys(now, arm):  # any step would start away from the set-point
            commands.servo_cp = target.command(now)
            return Notice()
        self._check_lag(arm)
        R_RV = arm.R_WR.T @ R_WV
        try:
            if mode is ControlMode.POSITION:
                target.follow_hand(sample, scale, R_RV, moves=moves, rolls=rolls)
            else:
                factor = scale / DEFAULT_SCALE
                target.follow_rate(sample, dt, factor, R_RV, arm, moves=moves, rolls=rolls)
        except HandJumpError as error:
            text = f"{self._settings.leader} {error}"
            raise DisengagedError(Reason.HAND_JUMP, text) from error
        if target.due(now):
            commands.servo_cp = target.command(now)
        commands.jaw = self._jaw_command(dt, sample, arm)
        if not target.wall:
            return Notice()
        return Notice(Reason.AT_LIMIT, f"{self._settings.arm} is at its {target.wall} limit")

    def _obeys(self, now: float, arm: ArmView) -> bool:
        """Whether the arm executes our stream; False only until it has begun to."""
        obeys = arm.stream == self._settings.node
        if not obeys and (self._obeyed or now - self._began > GRACE):
            name = self._settings.arm
            cause = f" ({arm.reason})" if arm.reason else f" (see {name}/warning)"
            raise DisengagedError(Reason.NOT_OBEYING, f"{name} does not obey{cause}")
        self._obeyed = obeys
        return obeys

    def _check_lag(self, arm: ArmView) -> None:
        lag, turned = self._target.behind(arm)
        if lag <= MAX_LAG and turned <= MAX_TURN_LAG:  # written so that NaN lets go
            return
        far = (
            f"{1e3 * lag:.0f} mm"
            if turned <= MAX_TURN_LAG
            else f"{math.degrees(turned):.0f} degrees"
        )
        raise DisengagedError(Reason.LAGGING, f"{self._settings.arm} is {far} behind the hand")

    def _jaw_command(self, dt: float, sample: LeaderSample, arm: ArmView) -> float | None:
        """The next jaw angle, if it changes. Many leaders have no grip before they are touched."""
        jaw = self._settings.jaw
        if sample.grip is None or jaw is None:
            self._jaw = None
            return None
        if self._jaw is None and math.isfinite(arm.jaw_set):
            self._jaw = JawFollower(jaw, self._settings.jaw_velocity, arm.jaw_set, sample.grip)
        if self._jaw is None:
            return None
        before = self._jaw.angle
        angle = self._jaw.tick(sample.grip, dt)
        return angle if angle != before else None


def _target(settings: TeleopSettings, now: float, sample: LeaderSample, arm: ArmView) -> TargetPose:
    wrist = settings.wrist_of(arm)
    if wrist is None:
        return StraightTarget(settings.workspace, settings.step, arm, sample, now)
    return WristedTarget(settings.workspace, settings.step, arm, sample, now, wrist)
