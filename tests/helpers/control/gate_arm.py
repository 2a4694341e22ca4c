"""An arm that is nothing but a gate: what a controller accepts, written down a second time.

From docs/reference/topics.md and docs/reference/safety.md, not from the controller's source: a
stream starts within
the slack of the set-point, steps no further than speed times time plus slack, ends after its
time-out, and must pause after ``hold``. It moves at most at the speed limit. Fast enough for a
hundred thousand storms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from surg_core.arm_view import ArmCommands, ArmState, ArmView

TICK = 0.002
SPEED, SLACK, ROLL_SPEED, ROLL_SLACK = 0.25, 0.002, 2.0, math.radians(2.0)
LONGEST, TIMEOUT = 0.1, 0.1
US = "/teleop"


@dataclass
class GateArm:
    """Takes or refuses what a teleoperation sends.

    Attributes:
        shallowest: Depth of the shallowest pose that it takes [m].
        refusals: Why motion commands were refused, in their order.
    """

    p: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 0.12]))
    roll: float = 0.0
    jaw: float = 0.0
    state: ArmState = ArmState.ENABLED
    homed: bool = True
    reason: str = ""
    holder: str = ""
    stuck: bool = False
    shallowest: float = 0.03
    tick: int = 0
    R_WR: np.ndarray = field(default_factory=lambda: np.eye(3))
    refusals: list[str] = field(default_factory=list)
    goal: np.ndarray | None = None
    goal_roll: float = 0.0
    since: float = 0.0
    held: float = math.inf  # since a hold, or a command refused for it

    def step(self, commands: ArmCommands) -> None:
        """One cycle."""
        self.tick += 1
        self.since += TICK
        self.held += TICK
        self._obey_state(commands.state)
        if commands.hold and self.state == ArmState.ENABLED:
            self.goal, self.held = None, 0.0
        if commands.servo_cp is not None:
            self._stream(commands.servo_cp.p, self._absolute(commands.servo_cp.q))
        if commands.claim and self.state == ArmState.ENABLED and self.holder in ("", US):
            self.holder = US
        if commands.jaw is not None and self.state == ArmState.ENABLED and self.holder in ("", US):
            self.jaw = commands.jaw
        if self.goal is not None and self.since > TIMEOUT + TICK / 2:
            self.goal, self.reason = None, "stale"
        self._move()

    def _obey_state(self, command: str | None) -> None:
        if command == "home":
            self.homed = True
        allowed = {
            "enable": (ArmState.DISABLED, ArmState.FAULT),
            "resume": (ArmState.PAUSED,),
            "pause": (ArmState.ENABLED,),
        }.get(command or "", ())
        if self.state in allowed:
            self.leave(ArmState.PAUSED if command == "pause" else ArmState.ENABLED, "")

    def leave(self, state: ArmState, reason: str) -> None:
        """Any change of state drops the goal and the holder."""
        self.state, self.reason, self.goal, self.holder = state, reason, None, ""

    def _absolute(self, q: np.ndarray) -> float:
        near = self.roll if self.goal is None else self.goal_roll
        asked = 2.0 * math.atan2(q[2], q[3])
        return near + math.remainder(asked - near, math.tau)

    def _stream(self, p: np.ndarray, roll: float) -> None:
        if self.state != ArmState.ENABLED:
            self.refusals.append("not_enabled")
            return
        if self.holder not in ("", US):
            self.refusals.append("no_authority")
            return
        if self.held <= TIMEOUT:
            self.held = 0.0
            self.refusals.append("held")
            return
        depth = float(np.linalg.norm(p))
        if not (self.shallowest <= depth <= 0.22 and p[2] >= depth * math.cos(1.0472)):
            self.refusals.append("outside_workspace")
            return
        begins = self.goal is None
        p0, roll0 = (self.p, self.roll) if begins else (self.goal, self.goal_roll)
        dt = 0.0 if begins else min(self.since, LONGEST)
        step, turn = float(np.linalg.norm(p - p0)), abs(roll - roll0)
        if not (step <= SPEED * dt + SLACK and turn <= ROLL_SPEED * dt + ROLL_SLACK):
            self.refusals.append("stream_start_too_far" if begins else "step_too_large")
            return
        self.goal, self.goal_roll, self.since, self.holder = p, roll, 0.0, US

    def _move(self) -> None:
        if self.goal is None or self.stuck or self.state != ArmState.ENABLED:
            return
        left = self.goal - self.p
        length = float(np.linalg.norm(left))
        most = SPEED * TICK
        self.p = self.goal if length <= most else self.p + left * (most / length)
        self.roll += min(max(self.goal_roll - self.roll, -ROLL_SPEED * TICK), ROLL_SPEED * TICK)

    def view(self) -> ArmView:
        """What a sender sees."""
        return ArmView(
            stamp_ns=self.tick * 2_000_000,
            state=self.state,
            homed=self.homed,
            busy=False,
            reason=self.reason,
            refused=len(self.refusals),
            p_BSet=self.p,
            p_BTip=self.p,
            R_BR=np.eye(3),
            roll_set=self.roll,
            jaw_set=self.jaw,
            holder=self.holder,
            stream=self.holder if self.goal is not None else "",
            R_WB=self.R_WR,
            received=self.tick * TICK,
        )
