"""The six joints of a wristed instrument: wrist centre, shaft roll, pitch and yaw of the wrist.

The hand turns and moves the tip. Targets are kept as joints, because the arm's limits are theirs: a
target at the end of a joint stays there, and on the way to it no joint outruns its drive, however
near the wrist is to its singular pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from surg_core import (
    WristConfig,
    WristGeometry,
    axis_angle_to_matrix,
    quaternion_xyzw_to_matrix,
    tip_of_wrist,
    wrists_of_tip,
)
from surg_core.arm_view import ArmView, Array, TipPose
from surg_core.transforms import minimal_rotation, tip_quaternion, twist_angle
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

    def __init__(self, config: WristConfig, turn: float, roll_max: float) -> None:
        """``turn``: of the pitch axis about the shaft; ``roll_max``: end of the roll [rad]."""
        lengths = config.geometry
        self._geometry = WristGeometry(lengths.pitch_to_yaw, lengths.yaw_to_tip, turn)
        self._low = np.array([-roll_max, *config.min]) + END
        self._high = np.array([roll_max, *config.max]) - END

    def of_arm(self, arm: ArmView) -> WristedTip:
        """The set-point of an arm; joints that came to rest beyond an end count as at the end.

        Raises:
            ValueError: The arm does not report its orientation, or it is singular.
        """
        if arm.q_RSet is None:
            raise ValueError("the arm does not report the orientation of its tip (q_set)")
        X_RTip = np.eye(4)
        X_RTip[:3, :3], X_RTip[:3, 3] = quaternion_xyzw_to_matrix(arm.q_RSet), arm.p_set
        found = self._joints(X_RTip, arm.roll_set)
        if found is None:
            raise ValueError("the wrist's yaw axis points to the trocar: straighten the wrist")
        return WristedTip(found.centre, np.clip(found.turns, self._low, self._high))

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
        angle = whole / pieces
        R = axis_angle_to_matrix(turn, angle) if angle > 0.0 else np.eye(3)
        wall = ""
        for _ in range(pieces):
            X_RTip = self._tip(joints)
            X_RTip[:3, :3] = R @ X_RTip[:3, :3]
            X_RTip[:3, 3] += step / pieces
            joints, wall = self._nearest(X_RTip, joints, workspace.from_here(joints.centre))
        return joints, wall

    def _nearest(
        self, X_RTip: Array, near: WristedTip, workspace: Workspace
    ) -> tuple[WristedTip, str]:
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
        found = wrists_of_tip(self._geometry, X_RTip)
        if not found:
            return None
        X_RCentre, wrist = found[0]
        centre = X_RCentre[:3, 3]
        swing = minimal_rotation([0.0, 0.0, 1.0], centre / np.linalg.norm(centre))
        roll = float(twist_angle(swing.T @ X_RCentre[:3, :3])[0])
        roll = near_roll + math.remainder(roll - near_roll, math.tau)
        return WristedTip(centre, np.array([roll, *wrist]))

    def _tip(self, joints: WristedTip) -> Array:
        X_RCentre = np.eye(4)
        q = tip_quaternion(joints.centre, float(joints.turns[0]))
        X_RCentre[:3, :3], X_RCentre[:3, 3] = quaternion_xyzw_to_matrix(q), joints.centre
        return np.array(tip_of_wrist(self._geometry, X_RCentre, joints.turns[1:]))
