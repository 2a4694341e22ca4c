"""Moves the tip along the axes of the camera and collects the pictures of each step.

Pure: cycles, camera and pictures in, commands out; the arm's stamps are the clock. Any problem ends
the check with a reason and a ``hold``. Nothing moves before the arm is ENABLED and homed, and
nothing is sent after the end.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from surg_core.arm_view import ArmCommands, ArmState, ArmView, Array, TipPose
from surg_core.bring_up import BringUp
from surg_core.contract import SECOND_NS, TICK_NS
from surg_teleop.frames.probe_moves import REST, SIDE, STEPS, ProbeMove, between
from surg_teleop.frames.tip_tracker import Picture
from surg_teleop.playback.workspace_fit import Workspace

STILL_S = 0.25
"""[s] The tip rests this long before a picture counts, because of lag and rolling shutters."""
PICTURE_S = 5.0
"""[s] Longest wait for a picture of the tip at rest."""
ARRIVE_S = 3.0
"""[s] Longest wait for the tip to arrive."""
THERE = 0.0007
"""[m] Tolerance of the arrival."""
CLOCKS_S = 7.0
"""[s] Largest difference between the stamps of picture and arm."""
SCOPE_MOVED = np.radians(0.5)
"""[rad] Largest rotation of the camera during the check."""


class FrameCheckStage(enum.Enum):
    """Stage of the check."""

    WAIT = "wait"
    GO = "go"
    LOOK = "look"
    BACK = "back"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class Pair:
    """Pictures of one exposure."""

    stamp_ns: int  # exposure [ns]
    left: Picture  # (h, w, 3) rgb8
    right: Picture | None  # of the right eye; None: there is one eye


@dataclass
class FramesCheck:
    """One check of one arm under one camera."""

    arm: str  # name of the arm, for messages
    node: str
    workspace: Workspace  # where the tip may be commanded
    enable: bool = False
    stage: FrameCheckStage = FrameCheckStage.WAIT
    reason: str = ""  # why it failed; empty otherwise
    pictures: dict[ProbeMove, Pair] = field(default_factory=dict)  # collected pictures, by step
    _rest: Array = field(default_factory=lambda: np.zeros(3), repr=False)
    _from: Array = field(default_factory=lambda: np.zeros(3), repr=False)
    _roll: float = field(default=0.0, repr=False)
    _R_RV: Array = field(default_factory=lambda: np.eye(3), repr=False)
    _since: int = field(default=0, repr=False)
    _still_since: int = field(default=0, repr=False)
    _refused: int = field(default=0, repr=False)
    _bring_up: BringUp | None = field(default=None, repr=False)

    @property
    def done(self) -> bool:
        """Whether nothing more will be sent."""
        return self.stage in (FrameCheckStage.DONE, FrameCheckStage.FAILED)

    @property
    def step(self) -> ProbeMove:
        """Present step, or the next one."""
        left = [step for step in STEPS if step not in self.pictures]
        return left[0] if left else REST

    def stop(self, reason: str) -> ArmCommands:
        """Abort the check; returns the commands to send now: hold, if the arm may be moving."""
        commands = ArmCommands(
            hold=self.stage in (FrameCheckStage.GO, FrameCheckStage.LOOK, FrameCheckStage.BACK)
        )
        if not self.done:
            self.stage, self.reason = FrameCheckStage.FAILED, reason
        return commands

    def tick(self, arm: ArmView, R_WV: Array | None, pair: Pair | None) -> ArmCommands:
        """Commands for the next cycle.

        R_WV (3, 3) is the view in the world according to the cell, `pair` the newest pictures;
        None: not known yet.
        """
        commands = ArmCommands(stamp_ns=arm.stamp_ns + TICK_NS)
        if self.done or self._prepare(arm, commands):
            return commands
        if problem := self._problem(arm, R_WV):
            return self._fail(problem, commands)
        if R_WV is None:
            return commands
        if self.stage is FrameCheckStage.WAIT:
            self._begin(arm, R_WV, commands)
        elif self.stage in (FrameCheckStage.GO, FrameCheckStage.BACK):
            self._go(arm, commands)
        elif self.stage is FrameCheckStage.LOOK:
            self._look(arm, pair, commands)
        return commands

    def _fail(self, reason: str, commands: ArmCommands) -> ArmCommands:
        commands.hold = self.stop(reason).hold
        commands.servo_cp = None
        return commands

    def _prepare(self, arm: ArmView, commands: ArmCommands) -> bool:
        """Home and enable the arm if allowed; returns whether this is under way."""
        if not self.enable or self.stage is not FrameCheckStage.WAIT:
            return False
        if arm.ready:
            return arm.busy
        if arm.state not in (ArmState.DISABLED, ArmState.ENABLED):
            return False
        if self._bring_up is None:
            self._bring_up = BringUp()
            self._bring_up.start(arm.stamp_ns)
        commands.state = self._bring_up.tick(arm, arm.stamp_ns).state
        return self._bring_up.active

    def _problem(self, arm: ArmView, R_WV: Array | None) -> str:
        """Why the check must end, or must not begin; empty: it need not."""
        why = f" ({arm.reason})" if arm.reason else ""
        if arm.state != ArmState.ENABLED:
            return (
                f"{self.arm} is {arm.state.name}{why}; enable it first with "
                f"'rostopic pub -1 /{self.arm}/state_command crtk_msgs/StringStamped \"string: "
                "enable\"'"
            )
        if not arm.homed:
            return f"{self.arm} is not homed; send the state_command 'home' first"
        if arm.holder not in ("", self.node):
            return f"{self.arm} is held by {arm.holder}; end that first"
        if self.stage is FrameCheckStage.WAIT:
            return ""
        if arm.refused > self._refused:
            return f"{self.arm} refused a command{why}; see {self.arm}/warning"
        if R_WV is not None:
            turned = float(np.linalg.norm(self._view(arm, R_WV) - self._R_RV)) / np.sqrt(2.0)
            if not turned < SCOPE_MOVED:
                return "the endoscope has moved; keep it at rest during the check"
        return ""

    def _view(self, arm: ArmView, R_WV: Array) -> Array:
        """The view in the rcm frame, (3, 3): the registration under test."""
        return np.asarray(arm.R_WR.T @ R_WV)

    def _begin(self, arm: ArmView, R_WV: Array, commands: ArmCommands) -> None:
        self._R_RV = self._view(arm, R_WV)
        self._rest = self._from = np.array(arm.p_set)
        self._roll, self._refused = arm.roll_set, arm.refused
        for step in STEPS:
            place = self._place(step)
            if wall := self.workspace.nearest(place)[1]:
                self._fail(
                    f"no room to move {step} ({wall} of the workspace); move the tip at least "
                    f"{1e3 * SIDE:.0f} mm away from its limits and try again",
                    commands,
                )
                return
        self._enter(FrameCheckStage.GO, arm)
        self._go(arm, commands)

    def _place(self, step: ProbeMove) -> Array:
        return np.asarray(self._rest + self._R_RV @ step.offset())

    def _enter(self, stage: FrameCheckStage, arm: ArmView) -> None:
        self.stage = stage
        self._since = self._still_since = arm.stamp_ns

    def _go(self, arm: ArmView, commands: ArmCommands) -> None:
        """Move to the target and check the arrival."""
        target = self._place(REST if self.stage is FrameCheckStage.BACK else self.step)
        seconds = (arm.stamp_ns - self._since) / SECOND_NS
        place, end = between(self._from, target, seconds)
        commands.servo_cp = TipPose(place, self._roll)
        if not end:
            self._still_since = arm.stamp_ns
            return
        if float(np.linalg.norm(arm.p_tip - target)) > THERE:
            if arm.stamp_ns - self._still_since > ARRIVE_S * SECOND_NS:
                off = 1e3 * float(np.linalg.norm(arm.p_tip - target))
                self._fail(
                    f"the tip stops {off:.1f} mm from its target; check for an obstacle", commands
                )
            return
        self._from = target
        if self.stage is FrameCheckStage.BACK:
            self.stage = FrameCheckStage.DONE
            commands.servo_cp, commands.hold = None, True
            return
        self._enter(FrameCheckStage.LOOK, arm)

    def _look(self, arm: ArmView, pair: Pair | None, commands: ArmCommands) -> None:
        """Rest until a picture has arrived."""
        commands.servo_cp = TipPose(self._from, self._roll)
        apart = 0.0 if pair is None else (arm.stamp_ns - pair.stamp_ns) / SECOND_NS
        if pair is not None and abs(apart) > CLOCKS_S:
            self._fail(
                f"the picture's stamp is {apart:.1f} s behind the arm's; check for a frozen "
                "picture, and the clock of the camera's machine",
                commands,
            )
        elif pair is not None and pair.stamp_ns >= self._still_since + STILL_S * SECOND_NS:
            self.pictures[self.step] = pair
            self._enter(
                FrameCheckStage.GO if len(self.pictures) < len(STEPS) else FrameCheckStage.BACK, arm
            )
        elif arm.stamp_ns - self._still_since > (STILL_S + PICTURE_S) * SECOND_NS:
            self._fail(
                f"no picture for {PICTURE_S:.0f} s; check that the endoscope node runs and sends "
                "both eyes",
                commands,
            )


def split(
    pictures: Mapping[ProbeMove, Pair],
) -> tuple[dict[ProbeMove, Picture], dict[ProbeMove, Picture] | None]:
    """Pictures of the left and the right eye; None: there is one eye."""
    left = {step: pair.left for step, pair in pictures.items()}
    right = {step: pair.right for step, pair in pictures.items() if pair.right is not None}
    return left, right if len(right) == len(left) else None
