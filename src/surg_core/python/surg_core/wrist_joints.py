"""The six joints behind a wrist and the tip that they hold.

Joints are one array (6,): wrist centre x, y, z in the rcm frame [m], roll, pitch and yaw [rad]. The
arm's limits hold for these numbers, so whoever interpolates, clips or judges a target does it here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from surg_core._core import (
    WristGeometry,
    WristOutputs,
    minimal_rotation,
    tip_of_wrist,
    wrists_of_tip,
)
from surg_core.transforms import (
    FloatArray,
    make_pose,
    matrix_to_quaternion_xyzw,
    rotate,
    tip_quaternion,
    twist_angle,
)


def tip_of_joints(wrist: WristGeometry, joints: FloatArray) -> FloatArray:
    """Pose (4, 4) of the tool frame in the rcm frame; a target's jaw may follow the joints."""
    X_RCentre = make_pose(joints[:3], tip_quaternion(joints[:3], float(joints[3])))
    return np.array(tip_of_wrist(wrist, X_RCentre, joints[4:6]))


def joints_of_tip(wrist: WristGeometry, X_RTip: FloatArray, near_roll: float) -> FloatArray | None:
    """The joints (6,) of a tip, of equal rolls the one nearest to ``near_roll`` [rad].

    None: the yaw axis points to the trocar, and the roll is free.
    """
    found = wrists_of_tip(wrist, X_RTip)
    if not found:
        return None
    X_RCentre, turns = found[0]
    centre = X_RCentre[:3, 3]
    swing = minimal_rotation([0.0, 0.0, 1.0], centre / np.linalg.norm(centre))
    roll = float(twist_angle(swing.T @ X_RCentre[:3, :3])[0])
    return np.array([*centre, near_roll + math.remainder(roll - near_roll, math.tau), *turns])


def wrist_centres(
    wrist: WristGeometry, p_RTip: FloatArray, q_RTip: FloatArray, yaw: FloatArray
) -> FloatArray:
    """Wrist centres (N, 3) of tips (N, 3) with orientations x, y, z, w (N, 4) and yaws (N,)."""
    across, along = np.sin(yaw), np.cos(yaw)
    link = [-np.sin(wrist.turn) * across, np.cos(wrist.turn) * across, along]
    lever = wrist.pitch_to_yaw * np.stack(link, axis=-1)
    lever[:, 2] += wrist.yaw_to_tip
    return np.asarray(p_RTip - rotate(q_RTip, lever))


@dataclass(frozen=True)
class WristView:
    """The wrist in one cycle, bit for bit as in surg_msgs/Cycle.

    Attributes:
        geometry: Lengths, and the turn that is known from homing on.
        measured: (2,) pitch and yaw [rad].
        set: Their set-point.
        goal: Those of the newest accepted target.
        q_RTip: (4,) measured orientation x, y, z, w of the tool frame in the trocar frame.
        q_RSet: Of the set-point.
        q_RGoal: Of the newest accepted target.
    """

    geometry: WristGeometry
    measured: FloatArray
    set: FloatArray
    goal: FloatArray
    q_RTip: FloatArray
    q_RSet: FloatArray
    q_RGoal: FloatArray

    @classmethod
    def of(cls, out: WristOutputs) -> WristView:
        """That of a controller in this process."""
        rotations = (out.R_RTip, out.R_RSet, out.R_RGoal)
        turns = (np.array(joints) for joints in (out.q, out.set, out.goal))
        return cls(out.geometry, *turns, *map(matrix_to_quaternion_xyzw, rotations))

    def centre(self, p_RTip: FloatArray, q_RTip: FloatArray, turns: FloatArray) -> FloatArray:
        """(3,) the wrist's centre in R [m], of a tip with these joints (2,) [rad]."""
        return wrist_centres(self.geometry, p_RTip[None], q_RTip[None], turns[None, 1])[0]
