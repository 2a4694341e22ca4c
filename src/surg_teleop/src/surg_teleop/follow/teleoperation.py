"""State machine of one leader on one arm.

========== ================================================ ===========================
from       event                                            to
========== ================================================ ===========================
DISABLED   enable                                           WAITING
WAITING    clutch pressed                                   CLUTCHED
WAITING    request to follow, all conditions met            FOLLOWING
CLUTCHED   request to follow, all conditions met            FOLLOWING
FOLLOWING  clutch pressed, hand jumps, arm does not obey    CLUTCHED
any but D. a condition is lost (:mod:`interlocks`)          WAITING, or FAULT (latched)
FAULT      enable                                           WAITING
any        disable                                          DISABLED
========== ================================================ ===========================

Only FOLLOWING moves the arm. Every exit from it sends ``hold``; every entry starts at the arm's
set-point, so an engagement cannot jump. Nothing engages by itself: it takes a request of the
operator (enable, release of the clutch, return to the controls) that has not expired. A gap in the
leader's samples cancels the request.

Pure: no ROS, no clock, no threads; time is an argument.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from surg_core.arm_view import ArmCommands, ArmState, ArmView
from surg_core.bring_up import BringUp
from surg_core.contract import SECOND_NS, TICK_NS
from surg_core.hand.leader_sample import LeaderSample
from surg_teleop.follow import interlocks
from surg_teleop.follow.engagement import AGAIN, DisengagedError, Engagement
from surg_teleop.follow.teleop_history import NEVER, TeleopHistory
from surg_teleop.follow.teleop_types import (
    ABANDONED,
    DEFAULT_SCALE,
    MAX_SCALE,
    MIN_SCALE,
    REQUEST_LIFETIME,
    RETRY,
    SILENCE,
    CameraView,
    ControlMode,
    Notice,
    Reason,
    TeleopInputs,
    TeleopOutput,
    TeleopSettings,
    TeleopState,
    fresh,
    older_than,
)


@dataclass
class Teleop:
    """One leader on one arm."""

    settings: TeleopSettings
    scale: float = DEFAULT_SCALE  # arm metres per metre of the hand; change it by :meth:`set_scale`
    lock_rotation: bool = False
    lock_translation: bool = False
    state: TeleopState = TeleopState.DISABLED
    engagements: int = 0  # number of engagements so far
    mode: ControlMode = field(init=False)  # the control mode in force
    _switch: bool | None = field(default=None, init=False, repr=False)
    _wanted_mode: ControlMode | None = field(default=None, init=False, repr=False)
    _history: TeleopHistory = field(default_factory=TeleopHistory, init=False, repr=False)
    _notice: Notice = field(default_factory=Notice, init=False, repr=False)
    _engagement: Engagement | None = field(default=None, init=False, repr=False)
    _bring_up: BringUp = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.mode = self.settings.mode
        # A view may be as old as SILENCE when it is read.
        self._bring_up = BringUp(resume=True, clear_fault=True, settle_ns=_ns(2.0 * SILENCE))

    def enable(self) -> None:
        """Home, enable or resume the arm as needed, then follow."""
        self._switch = True

    def disable(self) -> None:
        """Pause the arm and release it for other senders."""
        self._switch = False

    def set_scale(self, scale: float) -> str:
        """Change the scale at any time; returns why it is refused."""
        if not MIN_SCALE <= scale <= MAX_SCALE:
            return f"scale {scale:g} is refused; allowed: {MIN_SCALE:g} to {MAX_SCALE:g}"
        self.scale = scale
        return ""

    def set_mode(self, mode: ControlMode) -> None:
        """Change the control mode once CLUTCHED or WAITING; forgotten when the arm is disabled."""
        self._wanted_mode = mode

    def tick(
        self,
        now: float,
        sample: LeaderSample | None,
        arm: ArmView | None,
        camera: CameraView | None,
    ) -> TeleopOutput:
        """Evaluate everything once; a sample is repeated while there is no newer one."""
        commands = ArmCommands(stamp_ns=arm.stamp_ns + TICK_NS if arm else 0)
        last = self._history.ticked
        dt = now - last if math.isfinite(last) else 0.0
        valid = sample is not None and sample.finite()
        inputs = TeleopInputs(now, dt, sample, valid, arm, camera)
        self._remember(ticked=now)
        self._read_buttons(inputs)
        if self._switch is not None:
            on, self._switch = self._switch, None
            self._enable(now) if on else self._disable(now, arm, commands)
        self._check_arm_is_up(arm)
        if self.state is not TeleopState.DISABLED:
            self._step(inputs, commands)
        return TeleopOutput(self.state, commands, self._notice.text, self._notice.reason)

    def _remember(self, **changes: float) -> None:
        self._history = replace(self._history, **changes)  # type: ignore[arg-type]

    # Requests of the operator.

    def _read_buttons(self, inputs: TeleopInputs) -> None:
        sample = inputs.sample
        good = sample is not None and inputs.valid and fresh(inputs.now, sample.stamp)
        if sample is not None and good:
            self._remember(leader=sample.stamp)
        if sample is None or not good or sample.problem:
            self._history = self._history.gap()
            return
        before = self._history.buttons
        self._history = self._history.heard(sample, self.settings.need_present)
        pressed = sample.buttons - before if before is not None else frozenset()
        if "rate" in pressed:
            rate = self.mode is ControlMode.RATE
            self._change_mode(sample, ControlMode.POSITION if rate else ControlMode.RATE)
        elif self._wanted_mode is not None:
            self._change_mode(sample, self._wanted_mode)

    def _change_mode(self, sample: LeaderSample, other: ControlMode) -> None:
        """A request is for every leader; one that has only the present mode keeps it."""
        if self.state not in (TeleopState.CLUTCHED, TeleopState.WAITING):
            return
        if other.read(sample) is not None or self.mode.read(sample) is None:
            self.mode, self._wanted_mode = other, None

    def _enable(self, now: float) -> None:
        leader_there = self._history.buttons is not None
        requested = now if leader_there else NEVER
        self._remember(enabled=now, requested=requested)
        self._bring_up.start(_ns(now))
        if self.state in (TeleopState.DISABLED, TeleopState.FAULT):
            self.state = TeleopState.WAITING

    def _disable(self, now: float, arm: ArmView | None, commands: ArmCommands) -> None:
        self._leave(now, TeleopState.DISABLED, Notice(), commands)
        self._remember(requested=NEVER)
        self._wanted_mode = None
        self._bring_up.stop()
        if arm is not None and self._is_ours(arm):
            commands.state = "pause"

    def _check_arm_is_up(self, arm: ArmView | None) -> None:
        """Once the arm is up, ``enable`` is done: later pauses and faults are not overruled.

        A state that the arm reported right after ``enable`` may predate it.
        """
        if arm is not None and arm.ready and arm.received - self._history.enabled > SILENCE:
            self._bring_up.stop()

    def _is_ours(self, arm: ArmView) -> bool:
        return arm.holder == self.settings.node and arm.state == ArmState.ENABLED

    # The states.

    def _step(self, inputs: TeleopInputs, commands: ArmCommands) -> None:
        sample, arm, camera = inputs.sample, inputs.arm, inputs.camera
        blocked = interlocks.following(inputs, self.settings, self.mode, self._bring_up.active)
        if blocked is not None or sample is None or arm is None or camera is None:
            self._wait(inputs.now, blocked or Notice(), arm, commands)
        elif self.state is TeleopState.FOLLOWING:
            self._follow(inputs, sample, arm, camera, commands)
        elif self.state is not TeleopState.FAULT:
            self._begin(inputs.now, sample, arm, camera, commands)

    def _wait(self, now: float, notice: Notice, arm: ArmView | None, commands: ArmCommands) -> None:
        """A condition is not met: let go, then bring the arm up or release it."""
        if self.state is TeleopState.FAULT:
            return
        self._leave(
            now, TeleopState.FAULT if notice.fault else TeleopState.WAITING, notice, commands
        )
        if arm is None or self.state is TeleopState.FAULT or not fresh(now, arm.received):
            return
        if self._is_ours(arm) and older_than(ABANDONED, now, self._history.leader):
            self._bring_up.stop()
            if commands.state is None and now - self._history.paused >= RETRY:
                commands.state = "pause"
                self._remember(paused=now)
        elif commands.state is None:
            commands.state = self._bring_up.tick(arm, _ns(now)).state

    def _begin(
        self,
        now: float,
        sample: LeaderSample,
        arm: ArmView,
        camera: CameraView,
        commands: ArmCommands,
    ) -> None:
        """WAITING or CLUTCHED, and all conditions are met."""
        since_hold = now - self._history.held
        if "clutch" in sample.buttons:
            self.state, self._notice = TeleopState.CLUTCHED, Notice()
        elif now - self._history.requested > REQUEST_LIFETIME:
            if self.state is TeleopState.WAITING or not self._notice.text:
                self._notice = Notice(Reason.NOT_REQUESTED, f"ready; {AGAIN}")
        elif notice := interlocks.engagement(
            sample, arm, camera, self.settings, self.mode, since_hold
        ):
            self._notice = notice
        else:
            self._engage(now, sample, arm, commands)

    def _engage(
        self, now: float, sample: LeaderSample, arm: ArmView, commands: ArmCommands
    ) -> None:
        self.state, self._notice = TeleopState.FOLLOWING, Notice()
        self._remember(requested=NEVER)
        self._bring_up.stop()
        self.engagements += 1
        self._engagement = Engagement(self.settings, now, sample, arm)
        commands.claim = True
        commands.servo_cp = self._engagement.first_command()

    def _follow(
        self,
        inputs: TeleopInputs,
        sample: LeaderSample,
        arm: ArmView,
        camera: CameraView,
        commands: ArmCommands,
    ) -> None:
        assert self._engagement is not None
        if "clutch" in sample.buttons:
            self._leave(inputs.now, TeleopState.CLUTCHED, Notice(), commands)
            return
        try:
            self._notice = self._engagement.follow(
                inputs.now,
                inputs.dt,
                sample,
                arm,
                camera.R_WV,
                mode=self.mode,
                scale=self.scale,
                moves=not (self.lock_translation or "lock_translation" in sample.buttons),
                rolls=not (self.lock_rotation or "lock_rotation" in sample.buttons),
                commands=commands,
            )
        except DisengagedError as error:
            self._leave(inputs.now, TeleopState.CLUTCHED, error.notice, commands)

    def _leave(self, now: float, state: TeleopState, notice: Notice, commands: ArmCommands) -> None:
        if self.state is TeleopState.FOLLOWING:
            commands.hold = True
            self._remember(held=now, requested=NEVER)
        self._engagement = None
        self.state, self._notice = state, notice


def _ns(seconds: float) -> int:
    return round(seconds * SECOND_NS)
