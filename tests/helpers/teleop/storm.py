"""A storm of events on one hand and one arm, judged tick by tick.

What is asserted is written down here a second time, from docs/reference/teleoperation.md: only
FOLLOWING
commands, an engagement begins exactly at the set-point and only after an act of the operator, no
step is larger than the gate allows, nothing is ever refused, and the jaw opens by no more than the
hand.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.control.gate_arm import (
    LONGEST,
    ROLL_SLACK,
    ROLL_SPEED,
    SLACK,
    SPEED,
    TICK,
    GateArm,
)
from helpers.teleop.hand import Hand, settings
from surg_core.arm_view import ArmState
from surg_teleop.follow.teleop_types import REQUEST_LIFETIME, CameraView, ControlMode, TeleopState
from surg_teleop.follow.teleoperation import Teleop

Event = tuple[str, float]

EVENTS = (
    "move_x", "move_y", "move_z", "roll", "swing", "grip", "rate_x", "clutch", "present", "rate",
    "lock_rotation", "lock_translation", "jump", "nan", "silent", "problem", "enable", "disable",
    "scale", "camera", "base", "pause", "fault", "arm_off", "arm_on", "stranger", "stuck", "hold",
    "frozen", "wait", "recover",
)  # fmt: skip
"""Kinds of events; each comes with a number between -1 and 1."""


@dataclass
class Storm:
    """One run.

    Attributes:
        kind: The mapping at the start.
        need_present: Whether the operator must be known to be there.
        ticks: Ticks of the teleoperation so far.
        largest: Largest step commanded, as a share of what was allowed.
    """

    kind: ControlMode = ControlMode.POSITION
    need_present: bool = False
    ticks: int = 0
    largest: float = 0.0
    hand: Hand = field(default_factory=Hand)
    arm: GateArm = field(default_factory=lambda: GateArm(jaw=0.3))
    camera: np.ndarray = field(default_factory=lambda: np.eye(3))
    _told: tuple[np.ndarray, float, float] | None = None
    _acted: float = -math.inf
    _following: bool = False
    _by_hand: float = 0.0
    _by_jaw: float = 0.0
    _grip: float = 0.0
    _jaw: float = 0.0

    def __post_init__(self) -> None:
        self.hand.grip = 0.5
        made = settings(mode=self.kind, need_present=self.need_present)
        self.teleop = Teleop(made, scale=1.0)
        if self.need_present:
            self.hand.buttons = {"present"}
        self.tick(2)
        self._enable()
        self.tick(2)

    def run(self, events: Iterable[Event]) -> Storm:
        """Every event, and a few ticks after each."""
        for kind, value in events:
            self._do(kind, value)
            self.tick(1, 1 + int(abs(value) * 7))
        return self

    @property
    def now(self) -> float:
        """Of the next tick [s]."""
        return self.arm.tick * TICK

    def tick(self, n: int = 1, cycles: int = 1) -> None:
        """Runs ticks of the teleoperation, each with some control cycles of the arm."""
        for _ in range(n):
            self.ticks += 1
            now, view = self.now, self.arm.view()
            sample = self.hand.sample(now)
            out = self.teleop.tick(now, sample, view, CameraView(self.camera))
            self._judge(now, out)
            self.arm.step(out.commands)
            for _ in range(cycles - 1):
                self.arm.step(type(out.commands)())
            assert self.arm.refusals == [], f"refused: {self.arm.refusals}"

    def _judge(self, now: float, out: object) -> None:
        commands, following = out.commands, out.state is TeleopState.FOLLOWING  # type: ignore[attr-defined]
        if following and not self._following:
            assert now - self._acted <= REQUEST_LIFETIME + 1e-9, "engaged without an act"
            self._by_hand = self._by_jaw = 0.0
            # As the newest sample says: a hand that is silent for less than the limit may engage.
            self._grip, self._jaw = self.hand.said.grip, self.arm.jaw
            self._told = None
        if self._following and not following:
            assert commands.hold, "let go without hold"
            self._acted = -math.inf
        self._following = following
        if not following:
            assert commands.servo_cp is None
            assert commands.jaw is None
            return
        if commands.servo_cp is not None:
            self._judge_step(now, commands.servo_cp)
        if self.hand.speaks:
            self._by_hand += 0.7 * max(0.0, self.hand.grip - self._grip)
            self._grip = self.hand.grip
        if commands.jaw is not None:
            self._by_jaw += max(0.0, commands.jaw - self._jaw)
            self._jaw = commands.jaw
            assert self._by_jaw <= self._by_hand + 1e-9, "the jaw opened by itself"

    def _judge_step(self, now: float, pose: object) -> None:
        p, roll = pose.p, 2.0 * math.atan2(pose.q[2], pose.q[3])  # type: ignore[attr-defined]
        if self._told is None:
            assert np.array_equal(p, self.arm.p), "an engagement away from the set-point"
            assert abs(math.remainder(roll - self.arm.roll, math.tau)) < 1e-9
        else:
            p0, roll0, at = self._told
            dt = min(now - at, LONGEST)
            step, turn = float(np.linalg.norm(p - p0)), abs(math.remainder(roll - roll0, math.tau))
            share = max(step / (SPEED * dt + SLACK), turn / (ROLL_SPEED * dt + ROLL_SLACK))
            self.largest = max(self.largest, share)
            assert share <= 1.0 + 1e-9, "a step above the limit"
        self._told = p, roll, now

    def _enable(self) -> None:
        self.teleop.enable()
        self._acted = self.now

    def _press(self, button: str) -> None:
        """Presses it, or lets go."""
        down = button in self.hand.buttons
        self.hand.buttons ^= {button}
        if (button == "clutch" and down) or (button == "present" and not down):
            self._acted = self.now

    def _do(self, kind: str, value: float) -> None:
        hand, arm = self.hand, self.arm
        if kind.startswith("move_"):  # up to 4 mm: hands move that far in a sample
            hand.move(4e-3 * value * np.eye(3)["xyz".index(kind[-1])])
        elif kind == "jump":
            hand.move(np.array([0.3 * value, 0.0, 0.1]))
        elif kind == "roll":
            hand.turn(0.3 * value * hand.R[:, 2])
        elif kind == "swing":
            hand.turn(0.5 * value * hand.R[:, 0])
        elif kind == "grip":
            hand.grip = abs(value)
        elif kind == "rate_x":
            hand.v = np.array([0.3 * value, 0.0, 0.0]) if abs(value) > 0.3 else np.zeros(3)
        elif kind in ("clutch", "present", "rate", "lock_rotation", "lock_translation"):
            self._press(kind)
        elif kind == "nan":
            hand.broken = value > 0
        elif kind == "silent":
            hand.speaks = not hand.speaks
        elif kind == "problem":
            hand.problem = "is PAUSED" if value > 0 else ""
        elif kind == "enable":
            self._enable()
        elif kind == "disable":
            self.teleop.disable()
        elif kind == "scale":
            self.teleop.set_scale(value)
        elif kind == "camera":
            self.camera = Rotation.from_rotvec([value, 2.0 * value, 0.3]).as_matrix()
        elif kind == "base":
            arm.R_WR = Rotation.from_rotvec([0.5, value, -value]).as_matrix()
        elif kind in ("pause", "fault", "arm_off"):
            states = {"pause": ArmState.PAUSED, "fault": ArmState.FAULT}
            arm.leave(states.get(kind, ArmState.DISABLED), "operator")
        elif kind == "arm_on":
            arm.leave(ArmState.ENABLED, "")
        elif kind == "stranger":
            arm.holder = "/stranger" if value > 0 else ""
            arm.goal = None
        elif kind == "stuck":
            arm.stuck = value > 0
        elif kind == "hold" and arm.goal is not None:
            self._stolen_stream()
        elif kind == "frozen":
            arm.tick += int(400 * abs(value))
            arm.since += 400 * abs(value) * TICK
            arm.held += 400 * abs(value) * TICK
        elif kind == "recover":
            self._recover()
        elif kind == "wait":
            self.tick(int(8 * abs(value)) + 1, 15)

    def _recover(self) -> None:
        """Everything is well again, and the operator acts."""
        hand, arm = self.hand, self.arm
        hand.speaks, hand.broken, hand.problem, hand.v = True, False, "", np.zeros(3)
        hand.buttons = {"present"}
        arm.stuck, arm.holder = False, ""
        self._enable()
        self.tick(8, 15)

    def _stolen_stream(self) -> None:
        """A stall of the wire that ends the stream: the arm has stopped by its own watchdog."""
        self.arm.goal, self.arm.reason = None, "stale"
