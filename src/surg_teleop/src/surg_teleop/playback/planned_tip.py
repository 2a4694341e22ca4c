"""The tip along a plan: as planned, or where an instrument's wrist can bring it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from surg_core import WristConfig, make_pose
from surg_core.arm_view import ArmView, Array, TipPose
from surg_core.transforms import virtual_joints
from surg_teleop.follow.wristed_tip import WristedTip, WristRange
from surg_teleop.playback.motion_path import MotionPlan

BISECTIONS = 20
"""Of the clock's step, where the motion is too fast."""


@dataclass
class PlannedTip:
    """Poses of a plan; a wrist goes through them in the order of the calls.

    Attributes:
        wrist: The instrument's wrist, which follows the motion's rotations, and is straight without
            them; None: it has none.
        roll_max: End of a wristed instrument's roll [rad].
    """

    plan: MotionPlan
    wrist: WristConfig | None
    roll_max: float
    _range: WristRange | None = field(default=None, repr=False)
    _joints: WristedTip | None = field(default=None, repr=False)
    _joints_at: float = field(default=-1.0, repr=False)

    @property
    def wristed(self) -> bool:
        """Whether there is a wrist, from :meth:`begin` on."""
        return self._range is not None

    def begin(self, arm: ArmView) -> None:
        """Begin at the arm's joints, if it has a wrist."""
        if self.wrist is None or arm.wrist is None or self.wristed:
            return
        self._range = WristRange(self.wrist, arm.wrist.geometry, self.roll_max)
        self._joints = self._range.of_arm(arm)

    def pose(self, t: float) -> TipPose:
        """The pose at a time in the plan [s]."""
        if self._range is None:
            return TipPose(*self.plan.at(t))
        return self._range.pose(self._reached(t))

    def joints(self, t: float) -> Array:
        """The same as yaw, pitch [rad], insertion [m], roll [rad] (4,), or with the wrist (6,)."""
        end, turns = self._end(t)
        return np.append(virtual_joints(end, float(turns[0])), turns[1:])

    def _end(self, t: float) -> tuple[Array, Array]:
        """End of the shaft (3,) [m], and roll and joints of a wrist [rad], at a time [s]."""
        if self._range is None:
            p, roll = self.plan.at(t)
            return p, np.array([roll])
        joints = self._reached(t)
        return joints.centre, joints.turns

    def furthest(
        self, t: float, wanted: float, step: float, turns_allowed: tuple[float, float]
    ) -> float:
        """The latest time up to ``wanted`` [s] whose end is one step from that of ``t`` [s].

        A step is this long [m] and turns the roll and each joint of a wrist by at most these [rad].
        """
        roll_allowed, wrist_allowed = turns_allowed
        most = np.array([roll_allowed, wrist_allowed, wrist_allowed])
        p, turns = self._end(t)

        def fits(later: float) -> bool:
            p_next, turns_next = self._end(later)
            near = float(np.linalg.norm(p_next - p)) <= step
            return near and bool((np.abs(turns_next - turns) <= most[: len(turns)]).all())

        if fits(wanted):
            return wanted
        low, high = t, wanted
        for _ in range(BISECTIONS):
            middle = (low + high) / 2.0
            low, high = (middle, high) if fits(middle) else (low, middle)
        return low

    def _reached(self, t: float) -> WristedTip:
        """The joints at a time [s]; where the wrist is at an end, the tip keeps its place."""
        assert self._range is not None and self._joints is not None
        if t != self._joints_at:
            pose = TipPose(*self.plan.at(t), self.plan.turn(t))
            X_RTip = make_pose(pose.p, pose.q)
            workspace = self.plan.workspace.from_here(self._joints.centre)
            self._joints, _ = self._range.nearest(X_RTip, self._joints, workspace)
            self._joints_at = t
        return self._joints
