"""Expert for one arm: homes and enables it, then streams the tip along minimum-jerk profiles.

A task adds a script (``ScriptedExpert``).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import surg_core
from surg_core.arm_view import ArmCommands, ArmState, ArmView, TipPose
from surg_core.bring_up import BringUp
from surg_core.contract import STEP, TICK_NS
from surg_core.transforms import (
    make_pose,
    minimal_rotation,
    quaternion_xyzw_to_matrix,
    rotation_of,
)
from surg_sim.arrays import Array
from surg_sim.tasks.scripted_sender import (
    Action,
    MinimumJerk,
    Observation,
    ScriptedExpert,
    home_frame,
    into,
    out_of,
)

SHARE = 0.4
"""Share of the arm's limits that a profile uses; the rest is margin for the stream filter."""
ROLL_VELOCITY, ROLL_ACCELERATION = 1.0, 4.0
"""[rad/s], [rad/s^2]"""


class ArmExpert(ScriptedExpert):
    """A scripted expert for one arm; its path is in the rcm frame. The seed draws imperfections."""

    def __init__(self, cell: surg_core.Cell, seed: int, arm: str) -> None:
        self.arms = (arm,)
        self._arm = arm
        self.rng = np.random.default_rng([seed, *arm.encode()])
        limits = cell.arms[arm].limits
        self.X_WR = home_frame(cell.arms[arm])
        self.X_WB = np.asarray(cell.arms[arm].X_WB)
        instrument = cell.arms[arm].instrument
        self.jaw_open, self.jaw_closed = float(instrument.jaw_max), float(instrument.jaw_min)
        self.path = MinimumJerk(
            np.zeros(3), SHARE * limits.tip_velocity, SHARE * limits.tip_acceleration
        )
        self.roll = MinimumJerk(np.zeros(1), ROLL_VELOCITY, ROLL_ACCELERATION)
        self.done = False
        """The script has ended; the last pose is held."""
        self.expert_noise = 1.0
        """Factor of the error that the seed draws for the hand; large, and a grasp misses."""
        self.lean = np.zeros(0)
        """How a wrist leans the tool out of the shaft's line at first, see ``tool_pose``; (0,) for
        ever or (3,)."""
        self._script: Iterator[None] | None = None
        self._bring_up = BringUp()
        self._bring_up.start(0)

    @property
    def me(self) -> ArmView:
        """The arm as it is now."""
        return self.observation.arms[self._arm]

    def act(self, observation: Observation) -> Action:
        """See :class:`Expert`."""
        commands = ArmCommands()
        me = observation.arms[self._arm]
        if self.reason:
            return Action()
        if me.ready:
            self.observation = observation
            self._act(commands)
        elif me.state == ArmState.DISABLED and self._script is None:
            commands = self._bring_up.tick(me, observation.tick * TICK_NS)
            self.reason = self._bring_up.reason
        else:
            why = f": {me.reason}" if me.reason else ""
            self.reason = f"{self._arm} left ENABLED{why}"
        return Action(arms={self._arm: commands} if commands else {})

    def _act(self, commands: ArmCommands) -> None:
        if self._script is None:
            self.path.stay(self.p_set)
            self.roll.stay(np.append(self.me.roll_set, self.lean))
            self._script = self.script()
        if not self.done:
            try:
                next(self._script)
            except StopIteration:
                self.done = True
        p = self.path.advance(STEP)
        turns = self.roll.advance(STEP)
        commands.servo_cp = TipPose(p, float(turns[0]))
        if len(turns) > 1:
            R_WTool = self.tool_pose(out_of(self.X_WR, p), turns)[:3, :3]
            commands.servo_cp = TipPose(p, float(turns[0]), self.X_WR[:3, :3].T @ R_WTool)
        commands.jaw = self.jaw

    @property
    def p_set(self) -> Array:
        """Set-point of the tip, rcm frame [m], (3,)."""
        return into(self.X_WR, out_of(self.X_WB, self.me.p_BSet))

    def measured_tool(self, p_W: Array) -> Array:
        """Measured pose of the tool whose tip is at p_W (3,) [m], world, (4, 4)."""
        X = self.tool_pose(p_W, np.array([self.me.roll]))
        if self.me.wrist is not None:
            X[:3, :3] = self.X_WR[:3, :3] @ quaternion_xyzw_to_matrix(self.me.wrist.q_RTip)
        return X

    def tool_pose(self, p_W: Array, turns: Array) -> Array:
        """Pose of the tool for a place of its tip (3,) [m] and its turns, world, (4, 4).

        They are the roll [rad], (1,), and behind a wrist also the rotation vector in the rcm frame
        [rad] that leans the tool out of the line from trocar to tip, (4,).
        """
        p = self.local(p_W)
        swing = self.X_WR[:3, :3] @ minimal_rotation(np.eye(3)[2], p / np.linalg.norm(p))
        if len(turns) > 1:
            swing = self.X_WR[:3, :3] @ rotation_of(turns[1:]) @ self.X_WR[:3, :3].T @ swing
        c, s = np.cos(turns[0]), np.sin(turns[0])
        return make_pose(p_W, swing @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
