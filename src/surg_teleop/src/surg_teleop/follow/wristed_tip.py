"""The six joints of a wristed instrument: wrist centre, shaft roll, pitch and yaw of the wrist.

The hand turns and moves the tip. Targets are kept as joints, because the arm's limits are theirs: a
target at the end of a joint stays there, and on the way to it no joint outruns its drive, however
near the wrist is to its singular pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from surg_core import WristConfig, WristGeometry
from surg_core.arm_view import ArmView, Array, TipPose
from surg_core.transforms import rotation_of
from surg_core.wrist_joints import joints_of_tip, tip_of_joints
from surg_teleop.playback.workspace_fit import Workspace

JOINTS = ("roll", "wrist pitch", "wrist yaw")
"""The turning joints, in the order of ``WristedTip.turns``."""
END = 1e-3
"""[rad] A limited joint stays this far inside its range."""
FINE, FINE_STEP = 0.03, 1e-3
"""[rad], [m] Largest motion of the tip in one piece. A larger one could pass the singular pose,
which is 0.17 rad beyond the end of the pitch, and come back on its other side."""
SLIDES = 6
"""Turns of the search for the place of a tip whose joints or centre are at an end."""


@dataclass(frozen=True)
class WristedTip:
    """Where the six joints are, or shall be.

    Attributes:
        centre: (3,) wrist centre in the rcm frame [m].
        turns: (3,) roll, pitch and yaw of the wrist [rad].
    """

    centre: Array
    turns: Array


class WristRange:
    """Kinematics and ends of one arm's wristed instrument."""

    def __init__(self, config: WristConfig, geometry: WristGeometry, roll_max: float) -> None:
        """``geometry``: with its turn; ``roll_max``: end of the roll [rad]."""
        self._geometry = geometry
        self._low = np.array([-roll_max, *config.min[:2]]) + END
        self._high = np.array([roll_max, *config.max[:2]]) - END

    def of_arm(self, arm: ArmView) -> WristedTip:
        """The set-point of an arm; joints that came to rest beyond an end count as at the end."""
        assert arm.wrist is not None
        turns = np.array([arm.roll_set, *arm.wrist.set])
        return WristedTip(arm.p_end, np.clip(turns, self._low, self._high))

    def pose(self, joints: WristedTip) -> TipPose:
        """The tip of these joints."""
        X_RTip = self._tip(joints)
        return TipPose(X_RTip[:3, 3], float(joints.turns[0]), X_RTip[:3, :3])

    def moved(
        self, joints: WristedTip, step: Array, turn: Array, workspace: Workspace
    ) -> tuple[WristedTip, str]:
        """Move the tip by a step (3,) [m] and a rotation vector (3,) [rad] in the rcm frame.

        Returns:
            The joints, inside their ranges and the workspace, and what limits them, or empty. The
            tip keeps its place where only the wrist is at an end.
        """
        whole, length = float(np.linalg.norm(turn)), float(np.linalg.norm(step))
        pieces = max(1, math.ceil(whole / FINE), math.ceil(length / FINE_STEP))
        R = rotation_of(turn / pieces)
        wall = ""
        for _ in range(pieces):
            X_RTip = self._tip(joints)
            X_RTip[:3, :3] = R @ X_RTip[:3, :3]
            X_RTip[:3, 3] += step / pieces
            joints, wall = self.nearest(X_RTip, joints, workspace.from_here(joints.centre))
        return joints, wall

    def nearest(
        self, X_RTip: Array, near: WristedTip, workspace: Workspace
    ) -> tuple[WristedTip, str]:
        """The joints of a tip (4, 4), or the nearest that there are, and what limits them.

        The tip keeps its place where only turning joints are at an end. ``near`` is where they come
        from; ``X_RTip`` is changed.
        """
        wall, held = "", near
        for _ in range(SLIDES):
            found = self._joints(X_RTip, float(near.turns[0]))
            if found is None:
                return near, "wrist pitch"
            turns = np.clip(found.turns, self._low, self._high)
            centre, outside = workspace.nearest(found.centre)
            held = WristedTip(centre, turns)
            ends = [name for name, off in zip(JOINTS, turns != found.turns, strict=True) if off]
            if not ends and not outside:
                break
            wall = outside or ends[0]
            X_RTip[:3, 3] += centre - found.centre
            if ends:
                X_RTip[:3, :3] = self._tip(held)[:3, :3]
        return held, wall

    def _joints(self, X_RTip: Array, near_roll: float) -> WristedTip | None:
        """The joints of a tip; of equal rolls the one nearest to ``near_roll`` [rad]."""
        found = joints_of_tip(self._geometry, X_RTip, near_roll)
        return None if found is None else WristedTip(found[:3], found[3:])

    def _tip(self, joints: WristedTip) -> Array:
        return tip_of_joints(self._geometry, np.array([*joints.centre, *joints.turns]))
