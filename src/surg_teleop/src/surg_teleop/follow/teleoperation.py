"""One hand on one arm: DISABLED -> WAITING -> FOLLOWING <-> CLUTCHED, or FAULT.

Pure: no ROS, no clock, no threads; one call of :meth:`Teleop.tick` whenever there is something new
to look at, time is an argument. Only FOLLOWING moves the arm. Every way out of it says ``hold`` and
is silent from then on, so every way into it begins at the arm's set-point: an engagement cannot
jump, whatever happened before. Nothing engages by itself: it takes an act of the operator (enable,
letting go of the clutch, coming back to the controls) not longer than ASKED ago.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from surg_teleop.follow.arm_view import PERIOD_NS, ArmState, ArmView, Commands, Jaw
from surg_teleop.follow.jaw_follower import JawGhost
from surg_teleop.follow.target_pose import HandJumpError, StepLimits, Target
from surg_teleop.leaders.leader import HandlePose, HandRate, LeaderSample
from surg_teleop.playback.workspace_fit import Workspace

Array = NDArray[np.float64]

SILENCE = 0.1
"""[s] A leader, an arm or a camera that has said nothing for longer is not there."""
ASKED = 5.0
"""[s] An act of the operator counts that long: an arm needs a moment to be enabled."""
RETRY = 0.5
"""[s] A state command that has shown no effect is sent again after this."""
ABANDONED = 2.0
"""[s] A leader that is silent for longer has left: the arm is paused, and free for others."""
GRACE = 0.15
"""[s] An arm that has not begun to obey by then does not."""
BEHIND = 0.03
"""[m] An arm that is further behind the hand is not following it."""
NEUTRAL = 1e-3
"""[m/s], and ten times that [rad/s]: a stick that says less is at rest."""
DEFAULT_SCALE = 0.2
MIN_SCALE, MAX_SCALE = 0.01, 1.0


class State(enum.Enum):
    """What a hand does to its arm."""

    DISABLED = "DISABLED"
    WAITING = "WAITING"
    FOLLOWING = "FOLLOWING"
    CLUTCHED = "CLUTCHED"
    FAULT = "FAULT"


class Kind(enum.Enum):
    """How a hand is mapped."""

    POSITION = "position"
    RATE = "rate"

    def of(self, sample: LeaderSample) -> HandlePose | HandRate | None:
        """What a sample says of the hand for this mapping; None: its leader does not offer it."""
        return sample.pose if self is Kind.POSITION else sample.rate


@dataclass(frozen=True)
class CameraView:
    """Which way the picture looks.

    Attributes:
        R_WV: (3, 3) the view frame V, the left eye's optical axes, in the world of the cell.
        received: When this was known, on the steady clock [s]; infinite for a camera that stands.
    """

    R_WV: Array
    received: float = math.inf


@dataclass(frozen=True)
class TeleopSettings:
    """What is fixed for one hand on one arm.

    Attributes:
        leader: The hand's name, for messages.
        arm: The arm's.
        node: Caller id under which the commands are sent.
        workspace: Where the tip may be commanded.
        step: How far one command may be from the last.
        quiet: Longer than the arm's ``servo_timeout`` [s]: after ``hold`` a stream must pause.
        jaw: Range of the jaw; None: the instrument has none.
        jaw_velocity: Rate of the jaw once hand and jaw have met [rad/s].
        kind: The mapping at the start.
        need_present: Follow only while the operator is known to be at the controls.
    """

    leader: str
    arm: str
    node: str
    workspace: Workspace
    step: StepLimits
    quiet: float = 0.15
    jaw: Jaw | None = None
    jaw_velocity: float = 3.0
    kind: Kind = Kind.POSITION
    need_present: bool = False


@dataclass(frozen=True)
class TeleopOutput:
    """What one tick decided.

    Attributes:
        state: The state after it.
        commands: What to send to the arm.
        message: Why the arm does not follow, or what holds it, with the cure; empty: all is well.
    """

    state: State
    commands: Commands
    message: str


@dataclass(frozen=True)
class _Obstacle:
    """Why the arm must not follow now.

    Attributes:
        text: For the operator, with the cure.
        fault: It is latched: only ``enable`` leads out.
    """

    text: str
    fault: bool = False


@dataclass
class Teleop:
    """One hand on one arm.

    Attributes:
        settings: What is fixed.
        scale: Arm metres per metre of the hand; :meth:`set_scale` changes it, never with a jump.
        lock_rotation: The shaft's roll stays.
        lock_translation: The tip stays.
        state: What the hand does to the arm.
        kind: The mapping in force.
        engagements: How often the arm began to follow.
    """

    settings: TeleopSettings
    scale: float = DEFAULT_SCALE
    lock_rotation: bool = False
    lock_translation: bool = False
    state: State = State.DISABLED
    engagements: int = 0
    kind: Kind = field(init=False)
    _message: str = field(default="", init=False, repr=False)
    _switch: bool | None = field(default=None, init=False, repr=False)
    _now: float = field(default=-math.inf, init=False, repr=False)
    _asked: float = field(default=-math.inf, init=False, repr=False)
    _enabling: float = field(default=-math.inf, init=False, repr=False)
    _sent_state: float = field(default=-math.inf, init=False, repr=False)
    _heard: float = field(default=-math.inf, init=False, repr=False)
    _ended: float = field(default=-math.inf, init=False, repr=False)
    _engaged: float = field(default=-math.inf, init=False, repr=False)
    _obeyed: bool = field(default=False, init=False, repr=False)
    _buttons: frozenset[str] | None = field(default=None, init=False, repr=False)
    _checked: tuple[LeaderSample, bool] | None = field(default=None, init=False, repr=False)
    _target: Target | None = field(default=None, init=False, repr=False)
    _ghost: JawGhost | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        """The mapping at the start is the settings'."""
        self.kind = self.settings.kind

    def enable(self) -> None:
        """The operator wants the arm to follow: homes, enables or resumes it, then engages."""
        self._switch = True

    def disable(self) -> None:
        """The operator has done: the arm is paused, and free for others."""
        self._switch = False

    def set_scale(self, scale: float) -> str:
        """Changes the scale, while following as well.

        Returns:
            Empty, or why the scale stays as it is.
        """
        if not MIN_SCALE <= scale <= MAX_SCALE:
            return f"scale {scale:g} is refused; allowed: {MIN_SCALE:g} to {MAX_SCALE:g}"
        self.scale = scale
        return ""

    def tick(
        self,
        now: float,
        sample: LeaderSample | None,
        arm: ArmView | None,
        camera: CameraView | None,
    ) -> TeleopOutput:
        """Looks at everything once.

        Args:
            now: Steady clock, never backwards [s].
            sample: The leader's newest sample, again and again if there is no newer one.
            arm: The arm's newest cycle.
            camera: Where the picture looks.

        Returns:
            State, commands and message.
        """
        commands = Commands(stamp_ns=arm.stamp_ns + PERIOD_NS if arm else 0)
        late = math.isfinite(self._now) and not _fresh(now, self._now)
        since, self._now = (now - self._now if math.isfinite(self._now) else 0.0), now
        self._feel(now, sample)
        if self._switch is not None:
            self._obey_switch(now, arm, commands)
        self._see_ready(arm)
        if self.state is not State.DISABLED:
            obstacle = self._obstacle(now, sample, arm, camera, late)
            if obstacle is not None or sample is None or arm is None or camera is None:
                self._wait(now, obstacle or _Obstacle(""), arm, commands)
            elif self.state is State.FOLLOWING:
                self._follow(now, since, sample, arm, camera, commands)
            elif self.state is not State.FAULT:
                self._begin(now, sample, arm, commands)
        return TeleopOutput(self.state, commands, self._message)

    # What the operator does.

    def _feel(self, now: float, sample: LeaderSample | None) -> None:
        """Edges of the buttons, within an unbroken run of good samples only.

        What changed during a silence, or with a device plugged in again, is no act of the operator;
        and what was asked for before it came back does not make the arm follow it.
        """
        silent = sample is None or not self._finite(sample) or not _fresh(now, sample.stamp)
        if sample is not None and not silent:
            self._heard = sample.stamp
        if sample is None or silent or sample.problem:
            self._buttons, self._asked = None, -math.inf
            return
        before, self._buttons = self._buttons, sample.buttons
        if before is None:
            return
        released = "clutch" in before - sample.buttons
        came = self.settings.need_present and "present" in sample.buttons - before
        if released or came:
            self._asked = now
        if "clutch" in sample.buttons:
            self._asked = -math.inf
        if "rate" in sample.buttons - before and self.state in (State.CLUTCHED, State.WAITING):
            other = Kind.RATE if self.kind is Kind.POSITION else Kind.POSITION
            # A pedal is pressed for every hand: one that has only the mapping in force keeps it.
            if other.of(sample) is not None or self.kind.of(sample) is None:
                self.kind = other

    def _finite(self, sample: LeaderSample) -> bool:
        """Whether a sample may be calculated with; a sample is looked at once."""
        if self._checked is None or self._checked[0] is not sample:
            self._checked = sample, sample.finite()
        return self._checked[1]

    def _obey_switch(self, now: float, arm: ArmView | None, commands: Commands) -> None:
        on, self._switch = self._switch, None
        if on:
            self._enabling = now
            self._asked = now if self._buttons is not None else -math.inf  # None: it is silent
            self._sent_state = -math.inf
            if self.state in (State.DISABLED, State.FAULT):
                self.state = State.WAITING
            return
        self._leave(now, State.DISABLED, "", commands)
        self._asked = self._enabling = -math.inf
        if arm is not None and arm.holder == self.settings.node and arm.state == ArmState.ENABLED:
            commands.state = "pause"

    def _see_ready(self, arm: ArmView | None) -> None:
        """Enable has done its work: who pauses the arm from here on, and a fault, is obeyed.

        What the arm says sooner may be of before the act.
        """
        ready = arm is not None and arm.homed and arm.state == ArmState.ENABLED
        if ready and arm is not None and arm.received - self._enabling > SILENCE:
            self._enabling = -math.inf

    # What stands in the way.

    def _obstacle(
        self,
        now: float,
        sample: LeaderSample | None,
        arm: ArmView | None,
        camera: CameraView | None,
        late: bool,
    ) -> _Obstacle | None:
        return (
            self._arm_obstacle(now, arm)
            or self._leader_obstacle(now, sample)
            or self._camera_obstacle(now, camera)
            or (
                _Obstacle("this node did not run for a moment; press the clutch or enable")
                if late
                else None
            )
        )

    def _arm_obstacle(self, now: float, arm: ArmView | None) -> _Obstacle | None:
        name, settings = self.settings.arm, self.settings
        if arm is None or not _fresh(now, arm.received):
            return _Obstacle(f"{name} is silent: is its controller running?")
        why = f" ({arm.reason})" if arm.reason else ""
        if arm.state == ArmState.FAULT:
            cure = "press enable when the cause is gone"
            return _Obstacle(f"{name} is in FAULT{why}; {cure}", fault=not self._wants_enabled(now))
        if not arm.homed or arm.state != ArmState.ENABLED:
            what = f"{arm.state.name}{why}" if arm.homed else "not homed"
            return _Obstacle(f"{name} is {what}; press enable")
        if arm.holder not in ("", settings.node):
            return _Obstacle(f"{name} is held by {arm.holder}; pause {name}, then press enable")
        return None

    def _leader_obstacle(self, now: float, sample: LeaderSample | None) -> _Obstacle | None:
        name = self.settings.leader
        again = "then press the clutch or enable"
        if sample is None or not _fresh(now, sample.stamp):
            if sample is not None and sample.problem:
                return _Obstacle(f"{name}: {sample.problem}")
            return _Obstacle(f"{name} is silent: is it connected and switched on? {again}")
        if not self._finite(sample):
            return _Obstacle(
                f"{name} says what is not a number or no rotation: check the device and its "
                "driver, then press enable",
                fault=True,
            )
        if sample.problem:
            return _Obstacle(f"{name}: {sample.problem}")
        if self.kind.of(sample) is None:
            return _Obstacle(
                f"{name} has no {self.kind.value}: choose the other mapping (button 'rate')"
            )
        if self.settings.need_present and "present" not in sample.buttons:
            return _Obstacle("nobody is at the controls (operator_present)")
        return None

    def _camera_obstacle(self, now: float, camera: CameraView | None) -> _Obstacle | None:
        if camera is None or not _fresh(now, camera.received):
            return _Obstacle(
                "the endoscope arm is silent, so nobody knows where the picture looks: is its "
                "controller running?"
            )
        if not np.isfinite(camera.R_WV).all():
            return _Obstacle("the endoscope arm says what is not a number", fault=True)
        return None

    def _start_obstacle(self, now: float, sample: LeaderSample, arm: ArmView) -> str:
        """Why following may not begin now, though it could go on."""
        depth = float(np.linalg.norm(arm.p_set))
        least = self.settings.workspace.depth_min
        if arm.busy:
            return f"{self.settings.arm} is busy"
        if depth < least:
            return (
                f"the tip is {1e3 * depth:.0f} mm deep, {1e3 * least:.0f} mm are needed: "
                f"{self.settings.arm}/rcm/insert"
            )
        if self.kind is Kind.RATE and not _at_rest(sample):
            return f"{self.settings.leader} is deflected: let its sticks go"
        if now - self._ended < self.settings.quiet:
            return f"{self.settings.arm} is coming to rest"
        return ""

    # The states.

    def _wants_enabled(self, now: float) -> bool:
        return now - self._enabling <= ASKED

    def _wait(
        self, now: float, obstacle: _Obstacle, arm: ArmView | None, commands: Commands
    ) -> None:
        if self.state is State.FAULT:
            return
        self._leave(now, State.FAULT if obstacle.fault else State.WAITING, obstacle.text, commands)
        if arm is None or self.state is State.FAULT or not _fresh(now, arm.received):
            return
        ours = arm.holder == self.settings.node and arm.state == ArmState.ENABLED
        if ours and now - self._heard > ABANDONED + 1e-9 and commands.state is None:
            self._ask(now, "pause", commands)
            self._enabling = -math.inf
        elif self._wants_enabled(now):
            wanted = {ArmState.ENABLED: "", ArmState.PAUSED: "resume"}.get(arm.state, "enable")
            self._ask(now, wanted if arm.homed else "home", commands)

    def _ask(self, now: float, command: str, commands: Commands) -> None:
        if command and now - self._sent_state >= RETRY:
            commands.state, self._sent_state = command, now

    def _begin(self, now: float, sample: LeaderSample, arm: ArmView, commands: Commands) -> None:
        """WAITING or CLUTCHED, and nothing in the way."""
        if "clutch" in sample.buttons:
            self.state, self._message = State.CLUTCHED, ""
        elif now - self._asked > ASKED:
            if self.state is State.WAITING or not self._message:
                self._message = "ready; press and release the clutch, or press enable"
        elif text := self._start_obstacle(now, sample, arm):
            self._message = text
        else:
            self._engage(now, sample, arm, commands)

    def _engage(self, now: float, sample: LeaderSample, arm: ArmView, commands: Commands) -> None:
        self.state, self._message = State.FOLLOWING, ""
        self._asked = self._enabling = -math.inf
        self._engaged, self._obeyed = now, False
        self.engagements += 1
        settings = self.settings
        self._target = Target(settings.workspace, settings.step, arm, sample, now)
        commands.claim = True
        commands.servo_cp = self._target.command(now)

    def _follow(
        self,
        now: float,
        since: float,
        sample: LeaderSample,
        arm: ArmView,
        camera: CameraView,
        commands: Commands,
    ) -> None:
        target, name = self._target, self.settings.arm
        assert target is not None
        if "clutch" in sample.buttons:
            self._leave(now, State.CLUTCHED, "", commands)
            return
        obeys = arm.stream == self.settings.node
        self._obeyed = self._obeyed or obeys
        if not obeys and (self._obeyed or now - self._engaged > GRACE):
            why = f" ({arm.reason})" if arm.reason else f" (see {name}/warning)"
            self._let_go(now, f"{name} does not obey{why}", commands)
            return
        if not self._obeyed:  # until then a step would be a beginning away from the set-point
            commands.servo_cp = target.command(now)
            return
        if not (behind := float(np.linalg.norm(target.wanted - arm.p_set))) <= BEHIND:
            self._let_go(now, f"{name} is {1e3 * behind:.0f} mm behind the hand", commands)
            return
        buttons = sample.buttons
        R_RV = arm.R_WR.T @ camera.R_WV
        try:
            if self.kind is Kind.POSITION:
                target.hand(
                    sample,
                    self.scale,
                    R_RV,
                    moves=not (self.lock_translation or "lock_translation" in buttons),
                    rolls=not (self.lock_rotation or "lock_rotation" in buttons),
                )
            else:
                target.stick(
                    sample,
                    since,
                    self.scale / DEFAULT_SCALE,
                    R_RV,
                    arm,
                    moves=not (self.lock_translation or "lock_translation" in buttons),
                    rolls=not (self.lock_rotation or "lock_rotation" in buttons),
                )
        except HandJumpError as error:
            self._let_go(now, f"{self.settings.leader} {error}", commands)
            return
        self._message = f"{name} is at its {target.wall} limit" if target.wall else ""
        if target.due(now):
            commands.servo_cp = target.command(now)
        self._move_jaw(since, sample, arm, commands)

    def _move_jaw(
        self, since: float, sample: LeaderSample, arm: ArmView, commands: Commands
    ) -> None:
        """The jaw is the hand's from its first grip on; many have none before they are touched."""
        jaw, velocity = self.settings.jaw, self.settings.jaw_velocity
        if sample.grip is None or jaw is None:
            self._ghost = None
            return
        if self._ghost is None and math.isfinite(arm.jaw_set):
            self._ghost = JawGhost(jaw, velocity, arm.jaw_set, sample.grip)
        if self._ghost is None:
            return
        before = self._ghost.angle
        if self._ghost.tick(sample.grip, since) != before:
            commands.jaw = self._ghost.angle

    def _let_go(self, now: float, text: str, commands: Commands) -> None:
        """The clutch, not by the operator: it takes an act to go on."""
        again = "press and release the clutch, or press enable"
        self._leave(now, State.CLUTCHED, f"let go: {text}; {again}", commands)

    def _leave(self, now: float, state: State, text: str, commands: Commands) -> None:
        if self.state is State.FOLLOWING:
            commands.hold = True
            self._ended = now
            self._asked = -math.inf
        self._target = self._ghost = None
        self.state, self._message = state, text


def _fresh(now: float, stamp: float) -> bool:
    # Ticks are no binary fractions: a nanosecond keeps the deadline on its tick.
    return now - stamp <= SILENCE + 1e-9


def _at_rest(sample: LeaderSample) -> bool:
    rate = sample.rate
    assert rate is not None
    linear = [float(np.linalg.norm(rate.v_V))]
    angular = [abs(rate.roll)]
    if rate.spherical is not None:
        yaw, pitch, insertion = rate.spherical.tolist()
        linear, angular = [abs(insertion)], [*angular, abs(yaw), abs(pitch)]
    return max(linear) <= NEUTRAL and max(angular) <= 10.0 * NEUTRAL
