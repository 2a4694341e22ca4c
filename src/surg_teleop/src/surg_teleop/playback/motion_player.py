"""Plays a recorded motion: brings the arm to its start, streams it, and releases the arm.

CONNECT -> HOME -> ENABLE -> MOVE -> SETTLE -> PLAY -> HOLD -> DONE, or FAILED with a reason. Pure:
no ROS, no clock. :meth:`MotionPlayer.tick` is called once per control cycle; time is the difference
of the cycles' stamps, so the same cycles always give the same commands.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np

from surg_core.arm_view import ArmCommands, ArmState, ArmView, JawRange, TipPose
from surg_core.bring_up import BringUp
from surg_core.contract import SECOND_NS, TICK_NS
from surg_teleop.playback.motion_plan import Plan

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
JAW_EVERY = 5
"""The jaw is commanded every fifth cycle, at 100 Hz."""


class Stage(enum.Enum):
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
    """

    plan: Plan
    mode: Mode
    jaw: JawRange
    stage: Stage = Stage.CONNECT
    reason: str = ""
    started_ns: int = 0
    refused: int = 0
    _bring_up: BringUp = field(default_factory=BringUp, repr=False)
    _since: int = field(default=0, repr=False)
    _sent: int = field(default=-1, repr=False)
    _ticks: int = field(default=0, repr=False)
    _refused_before: int = field(default=0, repr=False)

    @property
    def done(self) -> bool:
        """Whether nothing more will be sent."""
        return self.stage in (Stage.DONE, Stage.FAILED)

    @property
    def window_ns(self) -> tuple[int, int]:
        """Stamps of the first and the last command that belong to the recorded motion [ns]."""
        first, last = self.plan.window
        return (
            self.started_ns + round(first * SECOND_NS),
            self.started_ns + round(last * SECOND_NS),
        )

    def tick(self, feedback: ArmView) -> ArmCommands:
        """Commands for the next cycle, after one of the arm."""
        commands = ArmCommands(stamp_ns=feedback.stamp_ns + TICK_NS)
        if self.stage is Stage.CONNECT:
            self._enter(Stage.HOME, feedback)
            self._bring_up.start(feedback.stamp_ns)
        if not self.done and self._usable(feedback):
            step = {
                Stage.HOME: self._bring_arm_up,
                Stage.ENABLE: self._bring_arm_up,
                Stage.MOVE: self._move,
                Stage.SETTLE: self._settle,
                Stage.PLAY: self._play,
                Stage.HOLD: self._hold,
            }[self.stage]
            step(feedback, commands)
        return commands

    def _enter(self, stage: Stage, feedback: ArmView) -> None:
        self.stage = stage
        self._since = feedback.stamp_ns
        self._sent = -1

    def _fail(self, reason: str) -> None:
        self.stage, self.reason = Stage.FAILED, reason

    def _usable(self, feedback: ArmView) -> bool:
        """Fail if the arm has stopped; it is never resumed here."""
        why = f": {feedback.reason}" if feedback.reason else ""
        if feedback.state == ArmState.FAULT:
            self._fail(f"the arm is in FAULT{why} (while: {self.stage.value})")
        elif feedback.state == ArmState.PAUSED:
            self._fail(f"the arm is PAUSED{why} (while: {self.stage.value}); send 'resume' first")
        elif feedback.state == ArmState.DISABLED and self.stage not in (Stage.HOME, Stage.ENABLE):
            self._fail(f"the arm was disabled{why} (while: {self.stage.value})")
        return not self.done

    def _bring_arm_up(self, feedback: ArmView, commands: ArmCommands) -> None:
        commands.state = self._bring_up.tick(feedback, feedback.stamp_ns).state
        if self._bring_up.reason:
            self._fail(self._bring_up.reason)
        elif not self._bring_up.active:
            self._enter(Stage.MOVE, feedback)
            self._move(feedback, commands)
        elif feedback.homed and self.stage is Stage.HOME:
            self._enter(Stage.ENABLE, feedback)

    def _move(self, feedback: ArmView, commands: ArmCommands) -> None:
        now = feedback.stamp_ns
        target, roll = self.plan.at(0.0)
        away = float(np.linalg.norm(feedback.p_set - target))
        if self._sent < 0:
            self._sent = now
            commands.move_cp = TipPose(target, roll)
        elif now - self._sent < MOVE_MIN or feedback.busy:
            pass
        elif away <= START_TOLERANCE:
            self._enter(Stage.SETTLE, feedback)
            return
        if now - self._since > MOVE_TIMEOUT:
            why = f" ({feedback.reason})" if feedback.reason else ""
            self._fail(
                f"the arm did not reach the start of the motion in {MOVE_TIMEOUT // SECOND_NS} s: "
                f"its set-point is {1e3 * away:.1f} mm away{why}"
            )

    def _settle(self, feedback: ArmView, commands: ArmCommands) -> None:
        if feedback.stamp_ns - self._since >= SETTLE:
            self._enter(Stage.PLAY, feedback)
            self.started_ns = commands.stamp_ns
            self._refused_before = feedback.refused
            self._play(feedback, commands)

    def _play(self, feedback: ArmView, commands: ArmCommands) -> None:
        self.refused = feedback.refused - self._refused_before
        t = (commands.stamp_ns - self.started_ns) / SECOND_NS
        self._stream(t, commands)
        if t >= self.plan.duration:
            self._enter(Stage.HOLD, feedback)

    def _hold(self, feedback: ArmView, commands: ArmCommands) -> None:
        self.refused = feedback.refused - self._refused_before
        if feedback.stamp_ns - self._since < HOLD:
            self._stream(self.plan.duration, commands)
        else:
            commands.hold = True
            self._enter(Stage.DONE, feedback)

    def _stream(self, t: float, commands: ArmCommands) -> None:
        p, roll = self.plan.at(t)
        if self.mode is Mode.CARTESIAN:
            commands.servo_cp = TipPose(p, roll)
        else:
            commands.servo_jp = TipPose(p, roll).joints
        opening = self.plan.opening(t)
        if opening is not None and self._ticks % JAW_EVERY == 0:
            commands.jaw = min(self.jaw.min + opening, self.jaw.max)
        self._ticks += 1
