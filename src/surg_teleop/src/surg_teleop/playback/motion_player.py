"""Plays a recorded motion: brings the arm to its start, streams it, and releases the arm.

CONNECT -> HOME -> ENABLE -> MOVE -> SETTLE -> PLAY -> HOLD -> DONE, or FAILED with a reason. Pure:
no ROS, no clock. :meth:`MotionPlayer.tick` is called once per control cycle; time is the difference
of the cycles' stamps, so the same cycles always give the same commands.

The path is never left. Where the motion is faster than the arm's gate allows, its clock slows down.
While the arm refuses a pose, the clock stands still and the pose is sent again. If the arm refuses
for longer than the stream lives, the player rests, goes to the refused pose by MOVE and plays on.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

import numpy as np

from surg_core import WristConfig
from surg_core.arm_view import ArmCommands, ArmState, ArmView, JawRange
from surg_core.bring_up import BringUp
from surg_core.contract import SECOND_NS, TICK_NS
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.playback.motion_path import MotionPlan
from surg_teleop.playback.planned_tip import PlannedTip

MOVE_TIMEOUT = 15 * SECOND_NS
"""[ns] Longest time to reach the start of the motion."""
MOVE_MIN = SECOND_NS // 20
"""[ns] Time until the arm reports that it is busy."""
SETTLE = SECOND_NS // 4
"""[ns] Rest at the start, so that the servo's lag decays."""
HOLD = SECOND_NS // 2
"""[ns] Time for which the last pose is streamed, so that the arm arrives before the stream ends."""
START_TOLERANCE = 0.001
"""[m] Half of the controller's tolerance between set-point and first pose of a stream."""
REFUSED_MAX = SECOND_NS // 5
"""[ns] Time for which the arm may refuse a pose; then the stream is taken up again from rest."""
REST = 6 * SECOND_NS // 10
"""[ns] Silence before that: longer than any ``servo_timeout``, so that a blocked stream is over."""
PROGRESS = 0.1
"""[s] A restart that is further on in the motion than this counts as the first one."""
RESTARTS = 3
"""Restarts of the stream without progress; then the motion is given up."""
STUCK = SECOND_NS // 2
"""[ns] Time for which a motion's clock may stand still before a turn that no wrist can make."""
HARDLY = 1e-6
"""[s] A clock that advances by less in a cycle stands still."""
JAW_EVERY = 5
"""The jaw is commanded every fifth cycle, at 100 Hz."""


class PlayerStage(enum.Enum):
    """Stage of the player."""

    CONNECT = "connect"
    HOME = "home"
    ENABLE = "enable"
    MOVE = "move"
    SETTLE = "settle"
    PLAY = "play"
    HOLD = "hold"
    DONE = "done"
    FAILED = "failed"


class Mode(enum.Enum):
    """Which stream carries the motion."""

    CARTESIAN = "cartesian"
    SPHERICAL = "spherical"


@dataclass
class MotionPlayer:
    """Plays a plan on one arm.

    Attributes:
        jaw: Range of the jaw; the gripper's opening is clipped to it.
        reason: Why it has failed; empty otherwise.
        started_ns: Stamp of the start of the stream; 0 before.
        refused: Commands that the arm has refused during the stream.
        wrist: The instrument's wrist, which follows the motion's rotations; None: it is straight.
        roll_max: End of a wristed instrument's roll [rad].
        steps: Largest steps that the arm's gate accepts; None: the motion keeps its pace.
        first_refusal: Time in the plan [s] and cause of the first refused pose; None: none was.
        slowed_ns: By how much longer than planned the stream has become [ns].
    """

    plan: MotionPlan
    mode: Mode
    jaw: JawRange
    steps: StepLimits | None = None
    wrist: WristConfig | None = None
    roll_max: float = math.inf
    stage: PlayerStage = PlayerStage.CONNECT
    reason: str = ""
    started_ns: int = 0
    refused: int = 0
    first_refusal: tuple[float, str] | None = None
    slowed_ns: int = 0
    _bring_up: BringUp = field(default_factory=BringUp, repr=False)
    _since: int = field(default=0, repr=False)
    _sent: int = field(default=-1, repr=False)
    _ticks: int = field(default=0, repr=False)
    _refused_before: int = field(default=0, repr=False)
    _t: float = field(default=0.0, repr=False)
    _last: ArmView | None = field(default=None, repr=False)
    _refused_since: int = field(default=0, repr=False)
    _moved_at: int = field(default=0, repr=False)
    _restarts: int = field(default=0, repr=False)
    _restarted_at: float = field(default=-1.0, repr=False)
    _tip: PlannedTip = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Where the tip goes."""
        self._tip = PlannedTip(self.plan, self.wrist, self.roll_max)

    @property
    def done(self) -> bool:
        """Whether nothing more will be sent."""
        return self.stage in (PlayerStage.DONE, PlayerStage.FAILED)

    @property
    def clock(self) -> float:
        """Time in the plan [s] that the stream has reached."""
        return self._t

    @property
    def window_ns(self) -> tuple[int, int]:
        """Stamps of the first and the last command that belong to the recorded motion [ns]."""
        first, last = self.plan.window
        return (
            self.started_ns + round(first * SECOND_NS),
            self.started_ns + round(last * SECOND_NS) + self.slowed_ns,
        )

    def tick(self, feedback: ArmView) -> ArmCommands:
        """Commands for the next cycle, after one of the arm."""
        commands = ArmCommands(stamp_ns=feedback.stamp_ns + TICK_NS)
        if self.stage is PlayerStage.CONNECT:
            self._enter(PlayerStage.HOME, feedback)
            self._bring_up.start(feedback.stamp_ns)
        if not self.done and self._usable(feedback):
            step = {
                PlayerStage.HOME: self._bring_arm_up,
                PlayerStage.ENABLE: self._bring_arm_up,
                PlayerStage.MOVE: self._move,
                PlayerStage.SETTLE: self._settle,
                PlayerStage.PLAY: self._play,
                PlayerStage.HOLD: self._hold,
            }[self.stage]
            step(feedback, commands)
        return commands

    def _enter(self, stage: PlayerStage, feedback: ArmView) -> None:
        self.stage = stage
        self._since = feedback.stamp_ns
        self._sent = -1

    def _fail(self, reason: str) -> None:
        self.stage, self.reason = PlayerStage.FAILED, reason

    def _usable(self, feedback: ArmView) -> bool:
        """Fail if the arm has stopped; it is never resumed here."""
        why = f": {feedback.reason}" if feedback.reason else ""
        if feedback.state == ArmState.FAULT:
            self._fail(f"the arm is in FAULT{why} (while: {self.stage.value})")
        elif feedback.state == ArmState.PAUSED:
            self._fail(f"the arm is PAUSED{why} (while: {self.stage.value}); send 'resume' first")
        elif feedback.state == ArmState.DISABLED and not self._bring_up.active:
            self._fail(f"the arm was disabled{why} (while: {self.stage.value})")
        return not self.done

    def _bring_arm_up(self, feedback: ArmView, commands: ArmCommands) -> None:
        commands.state = self._bring_up.tick(feedback, feedback.stamp_ns).state
        if self._bring_up.reason:
            self._fail(self._bring_up.reason)
        elif not self._bring_up.active:
            self._enter(PlayerStage.MOVE, feedback)
            self._move(feedback, commands)
        elif feedback.homed and self.stage is PlayerStage.HOME:
            self._enter(PlayerStage.ENABLE, feedback)

    def _move(self, feedback: ArmView, commands: ArmCommands) -> None:
        now = feedback.stamp_ns
        self._tip.begin(feedback)
        pose = self._tip.pose(self._t)
        away = float(np.linalg.norm(feedback.p_set - pose.p))
        if self._restarts and now - self._since < REST:
            pass
        elif self._sent < 0:
            self._sent = now
            commands.move_cp = pose
        elif now - self._sent < MOVE_MIN or feedback.busy:
            pass
        elif away <= START_TOLERANCE:
            self._enter(PlayerStage.SETTLE, feedback)
            return
        if now - self._since > MOVE_TIMEOUT:
            why = f" ({feedback.reason})" if feedback.reason else ""
            self._fail(
                f"the arm did not reach the start of the motion in {MOVE_TIMEOUT // SECOND_NS} s: "
                f"its set-point is {1e3 * away:.1f} mm away{why}"
            )

    def _settle(self, feedback: ArmView, commands: ArmCommands) -> None:
        if feedback.stamp_ns - self._since >= SETTLE:
            self._enter(PlayerStage.PLAY, feedback)
            if not self.started_ns:
                self.started_ns = commands.stamp_ns
                self._refused_before = feedback.refused
            self._last, self._moved_at = None, feedback.stamp_ns
            self.slowed_ns = commands.stamp_ns - self.started_ns - round(self._t * SECOND_NS)
            self._play(feedback, commands)

    def _play(self, feedback: ArmView, commands: ArmCommands) -> None:
        self.refused = feedback.refused - self._refused_before
        if self._is_refusing(feedback):
            self._note_refusal(feedback)
            if feedback.stamp_ns - self._refused_since > REFUSED_MAX:
                self._restart(feedback)
                return
        else:
            self._refused_since = feedback.stamp_ns
            before = self._t
            self._advance(commands.stamp_ns)
            if self._t > before + HARDLY:
                self._moved_at = feedback.stamp_ns
            elif self._tip.wristed and feedback.stamp_ns - self._moved_at > STUCK:
                self._fail(
                    f"the wrist cannot turn as the motion does at {self._t:.3f} s "
                    f"({self.plan.place(self._t)}); turn less, or without r11 to r33"
                )
                commands.hold = True
                return
        self.slowed_ns = commands.stamp_ns - self.started_ns - round(self._t * SECOND_NS)
        self._last = feedback
        self._stream(self._t, commands)
        if self._t >= self.plan.duration:
            self._enter(PlayerStage.HOLD, feedback)

    def _is_refusing(self, feedback: ArmView) -> bool:
        """Whether the arm has refused commands since the last cycle and accepted none."""
        last = self._last
        return (
            last is not None
            and feedback.refused != last.refused
            and feedback.accepted == last.accepted
        )

    def _advance(self, stamp_ns: int) -> None:
        """Moves the motion's clock on, as far as the gate's steps allow."""
        wanted = (stamp_ns - self.started_ns - self.slowed_ns) / SECOND_NS
        if self._last is None or self.steps is None:
            self._t = wanted
            return
        since = (stamp_ns - self._last.stamp_ns - TICK_NS) / SECOND_NS
        allowed, roll_allowed = self.steps.allowed(since)
        turns_allowed = (roll_allowed, self.steps.allowed_wrist(since))
        self._t = self._tip.furthest(self._t, wanted, allowed, turns_allowed)

    def _note_refusal(self, feedback: ArmView) -> None:
        if self.first_refusal is None:
            self.first_refusal = (self._t, feedback.reason or "step_too_large or outside_workspace")

    def _restart(self, feedback: ArmView) -> None:
        """Takes the stream up again from rest, at the pose that was refused."""
        if self._t > self._restarted_at + PROGRESS:
            self._restarts = 0
        self._restarts += 1
        self._restarted_at = self._t
        if self._restarts > RESTARTS:
            t, why = self.first_refusal or (self._t, "")
            self._fail(
                f"the arm refused the motion {RESTARTS + 1} times at {self._t:.3f} s "
                f"({self.plan.place(self._t)}); first at {t:.3f} s: {why}"
            )
            return
        self._enter(PlayerStage.MOVE, feedback)

    def _hold(self, feedback: ArmView, commands: ArmCommands) -> None:
        self.refused = feedback.refused - self._refused_before
        if feedback.stamp_ns - self._since < HOLD:
            self._stream(self.plan.duration, commands)
        else:
            commands.hold = True
            self._enter(PlayerStage.DONE, feedback)

    def _stream(self, t: float, commands: ArmCommands) -> None:
        if self.mode is Mode.CARTESIAN:
            commands.servo_cp = self._tip.pose(t)
        else:
            commands.servo_jp = self._tip.joints(t)
        opening = self.plan.opening(t)
        if opening is not None and self._ticks % JAW_EVERY == 0:
            commands.jaw = min(self.jaw.min + opening, self.jaw.max)
        self._ticks += 1
